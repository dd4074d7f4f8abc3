/* Four numbers at a time: a `lane` holds the same quantity of LANES fingers of one shape.
 *
 * Everything the kernel does to one finger it does to LANES of them in one stroke, so the code below reads like code for one
 * finger. Arithmetic is the compiler's own (GCC and Clang vector extensions); only what the language lacks has a function here.
 * With LANES = 1 a lane is a double, and any C11 compiler will do.
 */
#ifndef GRASPFORCE_STRUCTURED_LANES_H
#define GRASPFORCE_STRUCTURED_LANES_H

#include <math.h>

#ifndef LANES
#if defined(__aarch64__)
#define LANES 2 /* what its registers hold */
#elif defined(__GNUC__)
#define LANES 4
#else
#define LANES 1
#endif
#endif

#if LANES > 1
typedef double lane __attribute__((vector_size(8 * LANES), may_alias));
typedef long long lane_bits __attribute__((vector_size(8 * LANES), may_alias)); /* all ones where true, else zero */
#else
typedef double lane;
typedef long long lane_bits;
#endif

/* Always inlined: lanes must not cross a call, whose convention for them depends on the machine that is compiled for. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#pragma GCC diagnostic ignored "-Wpsabi" /* warns of just that */
#else
#define INLINE static inline
#endif

INLINE lane lane_of(double value)
{
    return (lane){0} + value;
}

INLINE double lane_get(const lane *v, int i)
{
    return ((const double *)v)[i];
}

INLINE void lane_put(lane *v, int i, double value)
{
    ((double *)v)[i] = value;
}

INLINE void lane_flag(lane_bits *v, int i, int truth)
{
    ((long long *)v)[i] = truth ? -1 : 0;
}

/* a where true, b elsewhere. */
INLINE lane lane_pick(lane_bits truth, lane a, lane b)
{
#if LANES > 1
    return (lane)((truth & (lane_bits)a) | (~truth & (lane_bits)b));
#else
    return truth ? a : b;
#endif
}

/* v where true, zero elsewhere, whatever v is there: infinities and NaN go too. */
INLINE lane lane_where(lane_bits truth, lane v)
{
#if LANES > 1
    return (lane)(truth & (lane_bits)v);
#else
    return truth ? v : 0.0;
#endif
}

INLINE lane_bits lane_less(lane a, lane b)
{
#if LANES > 1
    return a < b;
#else
    return -(long long)(a < b);
#endif
}

INLINE lane lane_max(lane a, lane b)
{
    return lane_pick(lane_less(a, b), b, a);
}

INLINE lane lane_abs(lane v)
{
    return lane_max(v, -v);
}

INLINE lane lane_sqrt(lane v)
{
    lane root = v;
    for (int i = 0; i < LANES; i++) lane_put(&root, i, sqrt(lane_get(&v, i)));
    return root;
}

INLINE double lane_sum(lane v)
{
    double sum = 0.0;
    for (int i = 0; i < LANES; i++) sum += lane_get(&v, i);
    return sum;
}

INLINE double lane_top(lane v)
{
    double top = lane_get(&v, 0);
    for (int i = 1; i < LANES; i++) top = lane_get(&v, i) > top ? lane_get(&v, i) : top;
    return top;
}

#endif
