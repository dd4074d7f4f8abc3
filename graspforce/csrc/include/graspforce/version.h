/* Version of the graspforce library. */
#ifndef GF_VERSION_H
#define GF_VERSION_H

#ifdef __cplusplus
extern "C" {
#endif

/* Version of the headers that a program is compiled with. */
#define GF_VERSION_MAJOR 0
#define GF_VERSION_MINOR 2
#define GF_VERSION_PATCH 0
#define GF_VERSION       "0.2.0"

/* Return the version of the library that a program is linked with, for example "0.2.0". */
const char *gf_version(void);

#ifdef __cplusplus
}
#endif

#endif
