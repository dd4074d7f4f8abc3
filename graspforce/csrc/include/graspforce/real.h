/* The number type of the library: double, or float if GF_FLOAT32 is defined.
 *
 * Define GF_FLOAT32 for the library and for the programs that use it alike, for microcontrollers without a double-precision unit.
 * Then only the force solver and the controller exist, and forces are accurate to about 1e-5 of the largest one.
 */
#ifndef GF_REAL_H
#define GF_REAL_H

#ifdef GF_FLOAT32
typedef float gf_real;
#else
typedef double gf_real;
#endif

#endif
