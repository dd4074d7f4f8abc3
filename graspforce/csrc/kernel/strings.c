/* Version and status strings. */
#include "graspforce/problem.h"
#include "graspforce/version.h"

const char *gf_version(void)
{
    return GF_VERSION;
}

const char *gf_status_string(int status)
{
    switch (status) {
    case GF_OPTIMAL:
        return "optimal";
    case GF_INACCURATE:
        return "inaccurate";
    case GF_INFEASIBLE:
        return "infeasible";
    case GF_FAILED:
        return "failed";
    default:
        return "unknown";
    }
}
