/* The second-order cone Q = { x : x₀ ≥ ‖x₁‖ } and its Nesterov-Todd scaling, for any dimension ≥ 2.
 *
 * For s and z inside Q there is one symmetric W with W z = W⁻¹ s = λ. Written as 2 w wᵀ − J it loses half of the digits
 * near the boundary. In light-cone coordinates along a unit vector u,
 *
 *     x₊ = x₀ + u·x₁,    x₋ = x₀ − u·x₁,    x⊥ = x₁ − (u·x₁) u,
 *
 * it is diagonal, W⁻¹ = diag(g₊, g₋, g⊥), and nothing cancels. The product of Q's algebra is, in these coordinates,
 *
 *     (a ∘ b)± = a± b± + a⊥·b⊥,    (a ∘ b)⊥ = ½ (a₊ + a₋) b⊥ + ½ (b₊ + b₋) a⊥.
 */
#ifndef GRASPFORCE_STRUCTURED_CONE_H
#define GRASPFORCE_STRUCTURED_CONE_H

#include "structured_lanes.h"

enum { MAX_CONE = 4 };                        /* (f_n, f_t1, f_t2, m_n) */
enum { PLUS, MINUS, ACROSS, AXIS };           /* where a scaling keeps g₊, g₋, g⊥ and, from AXIS on, u */
enum { SCALING = AXIS + MAX_CONE - 1 };       /* its length */

/* The scaling of s and z, both inside the cone. */
INLINE void cone_scale(int n, const lane *s, const lane *z, lane *scaling)
{
    lane ss = s[1] * s[1], zz = z[1] * z[1], sz = s[0] * z[0] + s[1] * z[1];
    for (int i = 2; i < n; i++) {
        ss += s[i] * s[i];
        zz += z[i] * z[i];
        sz += s[i] * z[i];
    }
    lane s_norm = lane_sqrt(ss), z_norm = lane_sqrt(zz);
    lane s_det = (s[0] - s_norm) * (s[0] + s_norm), z_det = (z[0] - z_norm) * (z[0] + z_norm);
    lane s_unit = 1.0 / lane_sqrt(s_det), z_unit = 1.0 / lane_sqrt(z_det);
    lane share = 0.5 / lane_sqrt(0.5 * (1.0 + sz * s_unit * z_unit));
    s_unit *= share;
    z_unit *= share;
    lane w[MAX_CONE], ww = lane_of(0.0);
    for (int i = 1; i < n; i++) {
        w[i] = s[i] * s_unit - z[i] * z_unit; /* sinh of the boost, along u */
        ww += w[i] * w[i];
    }
    lane boost = lane_sqrt(ww);
    lane_bits none = lane_less(boost, lane_of(1e-150));
    lane inverse = 1.0 / lane_pick(none, lane_of(1.0), boost);
    for (int i = 1; i < n; i++) scaling[AXIS + i - 1] = w[i] * inverse;
    scaling[AXIS] = lane_pick(none, lane_of(1.0), scaling[AXIS]);
    lane stretch = boost + lane_sqrt(1.0 + ww);
    lane across = lane_sqrt(lane_sqrt(z_det / s_det));
    scaling[PLUS] = across / stretch;
    scaling[MINUS] = across * stretch;
    scaling[ACROSS] = across;
}

/* u·v₁ */
INLINE lane cone_along(int n, const lane *scaling, const lane *v)
{
    lane along = scaling[AXIS] * v[1];
    for (int i = 2; i < n; i++) along += scaling[AXIS + i - 1] * v[i];
    return along;
}

/* The vector with light-cone coordinates plus, minus and across. */
INLINE void cone_join(int n, const lane *scaling, lane plus, lane minus, const lane *across, lane *v)
{
    lane along = 0.5 * (plus - minus);
    v[0] = 0.5 * (plus + minus);
    for (int i = 1; i < n; i++) v[i] = along * scaling[AXIS + i - 1] + across[i];
}

/* result = W⁻² v */
INLINE void cone_weigh(int n, const lane *scaling, const lane *v, lane *result)
{
    lane along = cone_along(n, scaling, v), across[MAX_CONE];
    lane g = scaling[ACROSS] * scaling[ACROSS];
    for (int i = 1; i < n; i++) across[i] = g * (v[i] - along * scaling[AXIS + i - 1]);
    lane plus = scaling[PLUS] * scaling[PLUS] * (v[0] + along), minus = scaling[MINUS] * scaling[MINUS] * (v[0] - along);
    cone_join(n, scaling, plus, minus, across, result);
}

/* Adds W⁻² to the packed lower triangle M at row and column `at`. */
INLINE void cone_weigh_into(int n, const lane *scaling, int at, lane *M)
{
    const lane *u = scaling + AXIS - 1;
    lane plus = 0.5 * scaling[PLUS] * scaling[PLUS], minus = 0.5 * scaling[MINUS] * scaling[MINUS];
    lane across = scaling[ACROSS] * scaling[ACROSS], along = plus + minus, mixed = plus - minus;
    for (int i = 0; i < n; i++) {
        lane *row = M + (at + i) * (at + i + 1) / 2 + at;
        if (i == 0) {
            row[0] += along;
            continue;
        }
        row[0] += mixed * u[i];
        for (int j = 1; j < i; j++) row[j] += (along - across) * u[i] * u[j];
        row[i] += across + (along - across) * u[i] * u[i];
    }
}

/* What complementarity asks of the next step beyond its linear part: with ds and dz of the step that was tried,
 *
 *     ask = z + W⁻¹ (λ \ (W⁻¹ds ∘ W dz − σμ e)),
 *
 * where W⁻²s has been replaced by z, to which it is equal. Returns (W⁻¹ds ∘ W dz)₀ − σμ.
 */
INLINE lane cone_correct(int n, const lane *scaling, const lane *z, const lane *ds, const lane *dz, double target, lane *ask)
{
    const lane *u = scaling + AXIS - 1;
    lane plus_inv = 1.0 / scaling[PLUS], minus_inv = 1.0 / scaling[MINUS], across_inv = 1.0 / scaling[ACROSS];
    lane along = cone_along(n, scaling, z);
    lane l_plus = plus_inv * (z[0] + along), l_minus = minus_inv * (z[0] - along), l_across[MAX_CONE];
    for (int i = 1; i < n; i++) l_across[i] = across_inv * (z[i] - along * u[i]);
    along = cone_along(n, scaling, dz);
    lane a_plus = plus_inv * (dz[0] + along), a_minus = minus_inv * (dz[0] - along), a_across[MAX_CONE];
    for (int i = 1; i < n; i++) a_across[i] = across_inv * (dz[i] - along * u[i]);
    along = cone_along(n, scaling, ds);
    lane b_plus = scaling[PLUS] * (ds[0] + along), b_minus = scaling[MINUS] * (ds[0] - along), b_across[MAX_CONE];
    for (int i = 1; i < n; i++) b_across[i] = scaling[ACROSS] * (ds[i] - along * u[i]);

    lane ab = lane_of(0.0), ll = lane_of(0.0), lv = lane_of(0.0), v_across[MAX_CONE];
    for (int i = 1; i < n; i++) {
        ab += a_across[i] * b_across[i];
        v_across[i] = 0.5 * ((b_plus + b_minus) * a_across[i] + (a_plus + a_minus) * b_across[i]);
        ll += l_across[i] * l_across[i];
        lv += l_across[i] * v_across[i];
    }
    lane v_plus = b_plus * a_plus + ab - target, v_minus = b_minus * a_minus + ab - target;

    /* q = λ \ v, by way of λ⊥·q⊥ */
    lane lp_inv = 1.0 / l_plus, lm_inv = 1.0 / l_minus, middle = 0.5 * (l_plus + l_minus);
    lane lq = (lv - 0.5 * ll * (v_plus * lp_inv + v_minus * lm_inv)) * l_plus * l_minus / (middle * (l_plus * l_minus - ll));
    lane q_plus = (v_plus - lq) * lp_inv, q_minus = (v_minus - lq) * lm_inv;
    lane half = 0.5 * (q_plus + q_minus), inv = 1.0 / middle;
    for (int i = 1; i < n; i++) l_across[i] = scaling[ACROSS] * (v_across[i] - half * l_across[i]) * inv;
    cone_join(n, scaling, scaling[PLUS] * q_plus, scaling[MINUS] * q_minus, l_across, ask);
    for (int i = 0; i < n; i++) ask[i] += z[i];
    return 0.5 * (v_plus + v_minus);
}

/* The inverse of the longest step t with s + t ds in the cone; zero or less where every t ≥ 0 is allowed.
 * s + t ds leaves it at the smallest positive root of a t² + 2 b t + c, here without cancellation. */
INLINE lane cone_rate(int n, const lane *s, const lane *ds)
{
    lane ss = s[1] * s[1], a = ds[0] * ds[0] - ds[1] * ds[1], b = s[0] * ds[0] - s[1] * ds[1];
    for (int i = 2; i < n; i++) {
        ss += s[i] * s[i];
        a -= ds[i] * ds[i];
        b -= s[i] * ds[i];
    }
    lane norm = lane_sqrt(ss), c = (s[0] - norm) * (s[0] + norm), square = b * b - a * c;
    lane_bits outward = lane_less(lane_of(0.0), b), complex = lane_less(square, lane_of(0.0));
    lane root = lane_sqrt(lane_max(square, lane_of(0.0)));
    lane rate = lane_pick(outward, -a, root - b) / lane_pick(outward, root + b, c);
    return lane_max(lane_pick(complex, lane_of(0.0), rate), -ds[0] / s[0]);
}

#endif
