/* Shifted problems of shifted.h. */
#include "graspforce/shifted.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static const double NEGLIGIBLE = 1e-12; /* of the largest shift: a smaller difference of two shifts is rounding */
static const double IDLE = 1e6;         /* times the largest shift: bias of a half-space without a second vertex */
static const double NEAR_LIMIT = 1e-6;  /* relative: a torque this close to a limit counts as limited */
static const double NEAR_PLANE = 1e-6;  /* of the force: farther from its boundary, a half-space is not active */
static const double ACTIVE = 1e-9;      /* share of a cone's normal from which a half-space counts as active */

/* Compute β of all vertices. */
static void compute_shifts(const gf_shift_data *data, const double *w, double *shifts)
{
    const int rows = data->vertices * data->components;
    for (int r = 0; r < rows; r++) {
        const double *map = data->beta + 6 * (size_t)r;
        double sum = data->further[r];
        for (int c = 0; c < 6; c++) sum += map[c] * w[c];
        shifts[r] = sum;
    }
}

/* Write the row and the bias of each contact's further motor, and ‖D‖. Without a second vertex, the row is that of the first two
 * vertices, so that its entries stay in place, and the bias is so large that it does not matter. */
static void write_half_spaces(const gf_shift_data *data, const double *pair, const gf_shifted_problem *to, int first, int width)
{
    const int N = data->contacts, k = data->components, second = data->vertices > 1;
    double *square = to->largest, *bias = to->tau_u + first, size = 0.0;
    for (int i = 0; i < N; i++) square[i] = bias[i] = 0.0;
    for (int r = 0; r < data->vertices * k; r++) size = fmax(size, fabs(to->shifts[r]));
    for (int pass = 0; pass < 2; pass++)
        for (int c = 0; c < k; c++) {
            const int i = (int)data->owner[c], idle = pair[3 * i] == pair[3 * i + 1];
            const int from = idle ? 0 : (int)pair[3 * i], towards = idle ? second : (int)pair[3 * i + 1];
            const double D = to->shifts[(size_t)towards * (size_t)k + (size_t)c] -
                             to->shifts[(size_t)from * (size_t)k + (size_t)c];
            if (pass == 0) {
                square[i] += D * D;
                continue;
            }
            const double length = sqrt(square[i]), scale = length > NEGLIGIBLE * size ? 1.0 / length : 0.0;
            to->J[(size_t)c * (size_t)width + (size_t)(first + i)] = data->form[c] * D * scale;
            bias[i] += 0.5 * data->form[c] * D * D * scale;
        }
    for (int i = 0; i < N; i++) {
        const int idle = pair[3 * i] == pair[3 * i + 1] || !(sqrt(square[i]) > NEGLIGIBLE * size);
        square[i] = idle ? 0.0 : sqrt(square[i]);
        if (idle) bias[i] = size > 0.0 ? IDLE * size : 1.0;
    }
}

/* Write limits that leave room for the shifts of all vertices. Return 1 if they do. */
static int write_limits(const gf_shift_data *data, const double *J, const double *lower, const double *upper,
                        const gf_shifted_problem *to)
{
    const int N = data->contacts, k = data->components, n = data->motors;
    int fits = 1;
    for (int j = 0; j < n; j++) to->limits[j] = lower[j], to->limits[n + j] = upper[j];
    for (int v = 0; v < data->vertices; v++) {
        const double *shift = to->shifts + (size_t)v * (size_t)k;
        for (int j = 0; j < n; j++) {
            double load = 0.0;
            for (int c = 0; c < k; c++) load += J[(size_t)c * (size_t)n + (size_t)j] * shift[c];
            to->limits[j] = fmax(to->limits[j], lower[j] - load);
            to->limits[n + j] = fmin(to->limits[n + j], upper[j] - load);
        }
    }
    for (int j = 0; j < n; j++) fits = fits && to->limits[j] <= to->limits[n + j];
    for (int c = 0, i = -1; c < k; c++) {
        if ((int)data->owner[c] == i) continue;
        i = (int)data->owner[c];
        const int last = c + 1 < k && (int)data->owner[c + 1] == i ? c + 2 : c; /* the row of the normal force */
        double low = data->normal[i], high = data->normal[N + i], least = INFINITY, most = -INFINITY;
        for (int v = 0; v < data->vertices; v++) {
            const double shift = to->shifts[(size_t)v * (size_t)k + (size_t)last];
            least = fmin(least, shift), most = fmax(most, shift);
        }
        to->normal[i] = fmax(low - least - to->a[last], 0.0);
        to->normal[N + i] = high - most - to->a[last];
        fits = fits && to->normal[i] <= to->normal[N + i];
    }
    return fits;
}

int gf_shift_problem(const gf_shift_data *data, const double *pair, const double *w, const double *J, const double *tau_u,
                     const double *lower, const double *upper, gf_shifted_problem *to)
{
    const int k = data->components, n = data->motors, extra = data->weighs_forces ? k : 0, width = n + extra + data->contacts;
    compute_shifts(data, w, to->shifts);
    for (int c = 0; c < k; c++) {
        const int vertex = (int)pair[3 * (int)data->owner[c]];
        to->a[c] = data->offset[c] - (data->form[c] != 0.0 ? to->shifts[(size_t)vertex * (size_t)k + (size_t)c] : 0.0);
    }
    for (int r = 0; r < 6; r++) {
        double sum = w[r];
        for (int c = 0; c < k; c++) sum -= data->G[(size_t)r * (size_t)k + (size_t)c] * to->a[c];
        to->w[r] = sum;
    }
    for (int j = 0; j < n; j++) to->tau_u[j] = tau_u[j];
    for (int c = 0; c < k; c++) {
        const double *row = J + (size_t)c * (size_t)n;
        double *wide = to->J + (size_t)c * (size_t)width;
        for (int j = 0; j < n; j++) wide[j] = row[j], to->tau_u[j] += row[j] * to->a[c];
        for (int j = n; j < width; j++) wide[j] = 0.0;
        if (extra) wide[n + c] = data->root[c], to->tau_u[n + c] = data->root[c] * to->a[c];
    }
    write_half_spaces(data, pair, to, n + extra, width);
    return write_limits(data, J, lower, upper, to);
}

/* Return whether torques have the same optimum within the limits of the shifted problem as within those used: if the limits are
 * equal, or if the torques are within the new ones and away from the used ones. */
static int is_free(const gf_shift_data *data, const gf_shifted_problem *shifted, const double *tau, const double *used)
{
    const int n = data->motors;
    for (int j = 0; j < n; j++) {
        const double low = shifted->limits[j], high = shifted->limits[n + j], near = NEAR_LIMIT * fabs(tau[j]);
        if (low != used[j] && !(tau[j] >= low && tau[j] > used[j] + near)) return 0;
        if (high != used[n + j] && !(tau[j] <= high && tau[j] < used[n + j] - near)) return 0;
    }
    return 1;
}

/* Return the slip margin of contact i's force at `force`, N; components from `first` to `last`. */
static double slip_margin(const double *force, int count, double mu, double gamma)
{
    double load = hypot(force[0], force[1]);
    if (count == 4 && gamma > 0.0) load = hypot(load, mu / gamma * force[3]);
    return mu * force[2] - load;
}

gf_shift_outcome gf_check_shifted(const gf_shift_data *data, const gf_shifted_problem *shifted, const double *solution,
                                  const double *z, const double *eta, const double *room, const double *tau, const double *used,
                                  const double *mu, const double *gamma, double margin, double *pair, double *f)
{
    const int k = data->components;
    gf_shift_outcome outcome = GF_SHIFT_SOLVED;
    if (!is_free(data, shifted, tau, used)) return GF_SHIFT_LIMITS;
    for (int c = 0; c < k; c++) f[c] = shifted->a[c] + solution[c];
    for (int first = 0, last; first < k; first = last) {
        const int i = (int)data->owner[first];
        for (last = first + 1; last < k && (int)data->owner[last] == i;) last++;
        if (data->form[first] == 0.0 || last - first < 3) continue;
        /* the normal of the first cone is z, that of the half-space η (n_B − n_A)/(2 ‖D‖) */
        const double along = z[first + 2] * shifted->largest[i], moved = eta[i] * mu[i] * mu[i] * solution[first + 2];
        const int is_active = shifted->largest[i] > 0.0 && moved > ACTIVE * (along + moved) &&
                              room[i] < NEAR_PLANE * (fabs(solution[first + 2]) + shifted->largest[i]);
        int worst = -1;
        double least = margin;
        for (int v = 0; v < data->vertices; v++) {
            double force[4] = {0.0, 0.0, 0.0, 0.0};
            for (int c = first; c < last; c++) force[c - first] = f[c] + shifted->shifts[(size_t)v * (size_t)k + (size_t)c];
            const double own = slip_margin(force, last - first, mu[i], gamma[i]);
            if (own < least) least = own, worst = v;
        }
        double *own = pair + (size_t)3 * (size_t)i; /* primary, secondary, and the primary before */
        if (worst >= 0) {
            if (is_active || worst == (int)own[0] || (worst == (int)own[1] && shifted->largest[i] > 0.0))
                return GF_SHIFT_FAILED;
            outcome = GF_SHIFT_AGAIN;
            if (worst == (int)own[2]) {
                own[1] = worst; /* neither of both alone is sufficient */
            } else {
                own[2] = own[0];
                own[0] = own[1] = worst;
            }
        } else if (is_active && moved > along * (1.0 + ACTIVE)) { /* only the second cone limits the force */
            const double primary = own[0];
            own[0] = own[1], own[1] = primary;
            outcome = GF_SHIFT_AGAIN;
        }
    }
    return outcome;
}
