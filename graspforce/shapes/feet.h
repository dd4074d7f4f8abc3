/* The points of a surface that are nearest to a point: the closed forms of primitives.py, `feet`, one point at a time. */
#ifndef GRASPFORCE_FEET_H
#define GRASPFORCE_FEET_H

#include <math.h>

enum { FLAT, SPHERE, CYLINDER, BOX }; /* as Shape.closed_form says; FLAT has no surface of its own */

/* What is known of a surface: a sphere's radius; a cylinder's radius and half its height; half of a box's edges, m. */
typedef struct {
    int kind;
    double size[3];
} surface;

/* The unit vector along v, or +x where v is zero. */
static inline void along(const double v[3], double unit[3])
{
    double length = hypot(hypot(v[0], v[1]), v[2]);
    for (int k = 0; k < 3; k++) unit[k] = length > 0.0 ? v[k] / length : k == 0;
}

/* In place, how far a point is beyond each of `count` pairs of faces, to the same of a box's nearest point: from outside each
 * excess goes, from inside the least deficit, of several the first. */
static inline void box_foot(int count, double *beyond)
{
    int face = 0;
    for (int k = 1; k < count; k++)
        if (beyond[k] > beyond[face]) face = k;
    int inside = beyond[face] < 0.0;
    for (int k = 0; k < count; k++)
        if (beyond[k] > 0.0 || (inside && k == face)) beyond[k] = 0.0;
}

/* The nearest point of a surface that is not FLAT; where several are equally near, one of them. */
static inline void foot_of(const surface *s, const double p[3], double foot[3])
{
    const double *size = s->size;
    if (s->kind == SPHERE) {
        along(p, foot);
        for (int k = 0; k < 3; k++) foot[k] *= size[0];
    } else if (s->kind == CYLINDER) { /* in a half-plane through its axis it is a box */
        const double across[3] = {p[0], p[1], 0.0};
        double radial[3], beyond[2] = {hypot(p[0], p[1]) - size[0], fabs(p[2]) - size[1]};
        along(across, radial);
        box_foot(2, beyond);
        for (int k = 0; k < 2; k++) foot[k] = (beyond[0] + size[0]) * radial[k];
        foot[2] = p[2] < 0.0 ? -(beyond[1] + size[1]) : beyond[1] + size[1];
    } else {
        double beyond[3];
        for (int k = 0; k < 3; k++) beyond[k] = fabs(p[k]) - size[k];
        box_foot(3, beyond);
        for (int k = 0; k < 3; k++) foot[k] = p[k] < 0.0 ? -(beyond[k] + size[k]) : beyond[k] + size[k];
    }
}

#endif
