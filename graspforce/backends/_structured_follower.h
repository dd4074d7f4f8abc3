/* A problem that changes step by step, for Python (_structured.c). A Follower has its own copy of every number, so nobody can
 * change one behind it, and what a step brings counts only when all of it is known to be right. It finds the fingers in J and
 * keeps J within them; a J that couples others is not for it.
 */
#ifndef GRASPFORCE_STRUCTURED_FOLLOWER_H
#define GRASPFORCE_STRUCTURED_FOLLOWER_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdint.h>

#include "certify.h"
#include "grasp.h"
#include "structured.h"

/* What a problem gives: first what a step may change. */
enum {
    NOW_W, NOW_J, NOW_TAU_U, NOW_P, NOW_R, CHANGING,
    ITS_MU = CHANGING, ITS_GAMMA, ITS_MIN_NORMAL, ITS_MAX_NORMAL, ITS_LOWER, ITS_UPPER, ITS_WEIGHT, ITS_FACET, ITS_COST, GIVEN
};
static const char *const given_names[GIVEN] = {"w", "J", "tau_u", "p", "R", "mu", "gamma", "min_normal", "max_normal",
                                               "lower", "upper", "weight", "facet", "cost"};

enum { MOST_NUMBERS = 1 << 20 }; /* force components, motors, facets: as structured.h allows */

typedef struct {
    PyObject_HEAD
    graspforce_structure structure;
    int *indices;             /* the structure's integers */
    double *memory;           /* all numbers, then the workspace */
    void *workspace;
    int k, width;             /* width: how many numbers an answer has */
    Py_ssize_t size[GIVEN];   /* of each array as it is kept: J within the fingers alone */
    double *now[GIVEN];       /* the problem */
    double *fresh[CHANGING];  /* what a step brings, until it is known to be right */
    double *G, *fresh_G;
    graspforce_place place;
    double force_weight;
    int has_cost;
    double *answer;           /* f, y, z, nu_lower, nu_upper, lambda_lower, lambda_upper, torques */
    double *torque, *scratch; /* (n) each, for the certificate */
    int changed;              /* bit c: now[c] is not what was loaded */
    int loaded, used, busy;   /* used: the workspace has seen a problem */
} Follower;

/* ---- reading what Python gives ------------------------------------------------------------------------------------------ */

static int is_float64(const Py_buffer *view)
{
    return view->itemsize == (Py_ssize_t)sizeof(double) && view->format != NULL && strcmp(view->format, "d") == 0;
}

/* Copies an array, however it lies in memory. Returns 0, or -1 with an exception. */
static int read_numbers(PyObject *object, const char *name, Py_ssize_t count, double *to)
{
    Py_buffer view;
    if (object == Py_None && count == 0) return 0;
    if (PyObject_GetBuffer(object, &view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return -1;
    int result = -1;
    if (is_float64(&view) && view.len == count * (Py_ssize_t)sizeof(double))
        result = PyBuffer_ToContiguous(to, &view, view.len, 'C');
    else
        PyErr_Format(PyExc_ValueError, "%s must hold %zd float64", name, count);
    PyBuffer_Release(&view);
    return result;
}

/* The next two read numbers as the bits of IEEE 754, which compilers turn into vector instructions; comparing takes several times
 * as long. */

/* Whether all are 0 or −0: no bit but the sign's. */
static int all_zero(Py_ssize_t count, const double *x)
{
    uint64_t any = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, x + i, sizeof bits);
        any |= bits;
    }
    return any << 1 == 0;
}

/* Whether none is infinite or NaN: an exponent of all ones, to which adding one carries into the sign's place. */
static int all_finite(Py_ssize_t count, const double *x)
{
    const uint64_t exponent = UINT64_C(0x7FF) << 52, one = UINT64_C(1) << 52;
    uint64_t any = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, x + i, sizeof bits);
        any |= (bits & exponent) + one;
    }
    return any >> 63 == 0;
}

/* Copies what of J (k, n) is within the spans. Returns 0 where something is outside. */
static int pack_rows(const graspforce_structure *s, int k, const double *J, double *packed)
{
    const double *left = J, *end = J + (ptrdiff_t)k * s->joints; /* left: from where nothing has been looked at */
    int zero = 1;
    for (int c = 0; c < k; c++, J += s->joints) {
        const int first = s->span[2 * c], last = s->span[2 * c + 1];
        zero &= all_zero(J + first - left, left);
        for (int j = first; j < last; j++) *packed++ = J[j];
        left = J + last;
    }
    return zero && all_zero(end - left, left);
}

/* Likewise, of J as Python has it. Returns 1, 0, or -1 with an exception where its shape is not (k, n) or not float64. */
static int read_rows(const Follower *self, PyObject *object, double *packed)
{
    Py_buffer view;
    if (object == Py_None && self->structure.joints == 0) return 1;
    if (PyObject_GetBuffer(object, &view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return -1;
    int result = -1;
    double *dense = NULL;
    if (!is_float64(&view) || view.ndim != 2 || view.shape[0] != self->k || view.shape[1] != self->structure.joints)
        PyErr_Format(PyExc_ValueError, "J must hold float64 (%d, %d)", self->k, self->structure.joints);
    else if (PyBuffer_IsContiguous(&view, 'C'))
        result = pack_rows(&self->structure, self->k, view.buf, packed);
    else if ((dense = PyMem_Malloc((size_t)view.len + 1)) == NULL)
        PyErr_NoMemory();
    else if (PyBuffer_ToContiguous(dense, &view, view.len, 'C') == 0)
        result = pack_rows(&self->structure, self->k, dense, packed);
    PyMem_Free(dense);
    PyBuffer_Release(&view);
    return result;
}

/* ---- making one --------------------------------------------------------------------------------------------------------- */

/* Components of each contact, from where each stands among the padded ones, 4 i + (0, 1, 2, 3). Returns N, or 0. */
static int read_components(const Py_buffer *columns, int *components)
{
    const Py_ssize_t *column = columns->buf, k = columns->shape[0];
    int N = 0;
    for (Py_ssize_t c = 0; c < k; c += components[N++]) {
        int normal_alone = column[c] == 4 * (Py_ssize_t)N + 2;
        int count = normal_alone ? 1 : c + 3 < k && column[c + 3] == 4 * (Py_ssize_t)N + 3 ? 4 : 3;
        if (c + count > k) return 0;
        for (int a = 0; a < count && !normal_alone; a++)
            if (column[c + a] != 4 * (Py_ssize_t)N + a) return 0;
        components[N] = count;
    }
    return N;
}

/* The columns of J that each row's finger reaches from its first motor to its last. */
static void find_spans(const graspforce_structure *s, int *reach, int *span)
{
    for (int b = 0; b < s->blocks; b++) reach[2 * b] = reach[2 * b + 1] = 0;
    for (int j = 0; j < s->joints; j++) {
        int *own = reach + 2 * s->joint_block[j];
        if (own[1] == 0) own[0] = j;
        own[1] = j + 1;
    }
    for (int i = 0; i < s->contacts; i++)
        for (int c = 0; c < s->components[i]; c++, span += 2) memcpy(span, reach + 2 * s->contact_block[i], 2 * sizeof *span);
}

/* The structure, from what stands where among the padded components, J (k, n) and the contacts of the facets. Returns 0, or -1
 * with an exception: OverflowError where a finger has more force components than `most`. */
static int find_structure(Follower *self, int most, const Py_buffer *columns, const Py_buffer *J, const Py_buffer *facets)
{
    const Py_ssize_t k = columns->shape[0], n = J->obj ? J->shape[1] : 0, m = facets->obj ? facets->shape[0] : 0;
    if (k > MOST_NUMBERS || n > MOST_NUMBERS || m > MOST_NUMBERS || (J->obj && J->shape[0] != k)) {
        PyErr_SetString(PyExc_ValueError, "columns (k), J (k, n) and facet_contact must fit together");
        return -1;
    }
    int *at = self->indices = PyMem_Malloc(sizeof(int) * (size_t)(6 * k + n + m + 1));
    if (at == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    int *components = at, *contact_block = at + k, *reach = at + 2 * k, *span = at + 4 * k, *joint_block = at + 6 * k;
    graspforce_structure *s = &self->structure;
    *s = (graspforce_structure){.contacts = read_components(columns, components), .joints = (int)n, .facets = (int)m,
                                .components = components, .contact_block = contact_block, .joint_block = joint_block,
                                .facet_contact = joint_block + n, .span = span};
    if (m > 0) memcpy(joint_block + n, facets->buf, (size_t)m * sizeof(int));
    if (s->contacts == 0) {
        PyErr_SetString(PyExc_ValueError, "columns must be those of contacts with 1, 3 or 4 components");
        return -1;
    }
    int largest;
    self->k = (int)k;
    s->blocks = graspforce_fingers(s->contacts, components, (int)n, J->buf, contact_block, joint_block, &largest);
    if (largest > most) {
        PyErr_Format(PyExc_OverflowError, "at most %d force components that share joints, not %d", most, largest);
        return -1;
    }
    find_spans(s, reach, span);
    return 0;
}

/* Gives the numbers their memory. Returns 0, or -1 with an exception. */
static int make_room(Follower *self)
{
    const graspforce_structure *s = &self->structure;
    const Py_ssize_t N = s->contacts, n = s->joints, m = s->facets, k = self->k;
    Py_ssize_t *size = self->size, kept = 0, changing = 0;
    for (int c = 0; c < k; c++) size[NOW_J] += s->span[2 * c + 1] - s->span[2 * c];
    size[NOW_W] = 6, size[NOW_TAU_U] = n, size[NOW_P] = 3 * N, size[NOW_R] = 9 * N;
    size[ITS_MU] = size[ITS_GAMMA] = size[ITS_MIN_NORMAL] = size[ITS_MAX_NORMAL] = N;
    size[ITS_LOWER] = size[ITS_UPPER] = size[ITS_WEIGHT] = n, size[ITS_FACET] = 4 * m, size[ITS_COST] = k;
    self->width = (int)(2 * k + 6 + 2 * N + 3 * n);
    for (int a = 0; a < GIVEN; a++) kept += size[a], changing += a < CHANGING ? size[a] : 0;
    size_t count = (size_t)(kept + changing + 12 * k + self->width + 2 * n), workspace = graspforce_workspace_size(s);
    if (workspace == 0) {
        PyErr_SetString(PyExc_ValueError, "facet_contact describes no pyramids of these contacts");
        return -1;
    }
    double *at = self->memory = PyMem_RawMalloc(count * sizeof(double) + workspace);
    if (at == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    self->workspace = at + count;
    for (int a = 0; a < GIVEN; at += size[a++]) self->now[a] = at;
    for (int a = 0; a < CHANGING; at += size[a++]) self->fresh[a] = at;
    self->G = at, self->fresh_G = at + 6 * k, at += 12 * k;
    self->answer = at, self->torque = at + self->width, self->scratch = self->torque + n;
    memset(self->answer, 0, (size_t)self->width * sizeof(double));
    return 0;
}

/* Copies a problem of the same shape: arrays in the order of GIVEN, then force_weight. Returns 1, or 0 and takes nothing where
 * its J couples other fingers, or -1 with an exception, and no problem is loaded. */
static int load(Follower *self, PyObject *const *arrays)
{
    int rows = read_rows(self, arrays[NOW_J], self->fresh[NOW_J]);
    if (rows == 0) return 0;
    self->loaded = self->changed = 0;
    if (rows < 0) return -1;
    memcpy(self->now[NOW_J], self->fresh[NOW_J], (size_t)self->size[NOW_J] * sizeof(double));
    self->has_cost = arrays[ITS_COST] != Py_None;
    for (int a = 0; a < GIVEN; a++) {
        if (a == NOW_J || (a == ITS_COST && !self->has_cost)) continue;
        if (a == ITS_WEIGHT && arrays[a] == Py_None)
            memset(self->now[a], 0, (size_t)self->size[a] * sizeof(double)); /* torques cost nothing */
        else if (read_numbers(arrays[a], given_names[a], self->size[a], self->now[a]) < 0)
            return -1;
    }
    self->force_weight = PyFloat_AsDouble(arrays[GIVEN]);
    if (PyErr_Occurred()) return -1;
    if (!graspforce_grasp(&self->structure, self->now[NOW_P], self->now[NOW_R], self->G, &self->place)) {
        PyErr_SetString(PyExc_ValueError, "p and R must make a finite G");
        return -1;
    }
    self->loaded = 1;
    return 1;
}

/* ---- changes ------------------------------------------------------------------------------------------------------------ */

/* Puts one array of a step where it waits. Returns 0 where it is not float64 of the right shape, finite, J within its fingers. */
static int read_change(const Follower *self, int a, PyObject *object)
{
    const Py_ssize_t N = self->structure.contacts, n = self->structure.joints;
    const Py_ssize_t shape[CHANGING][3] = {{6}, {self->k, n}, {n}, {N, 3}, {N, 3, 3}};
    static const int dimensions[CHANGING] = {1, 2, 1, 2, 3};
    int fits;
    if (a == NOW_J) {
        fits = n > 0 && read_rows(self, object, self->fresh[a]) == 1;
    } else {
        Py_buffer view;
        fits = PyObject_GetBuffer(object, &view, PyBUF_STRIDES | PyBUF_FORMAT) == 0;
        if (fits) {
            fits = is_float64(&view) && view.ndim == dimensions[a] && view.len > 0;
            for (int d = 0; fits && d < view.ndim; d++) fits = view.shape[d] == shape[a][d];
            if (fits) fits = PyBuffer_ToContiguous(self->fresh[a], &view, view.len, 'C') == 0;
            PyBuffer_Release(&view);
        }
    }
    PyErr_Clear(); /* `step` says it by returning None */
    return fits && all_finite(self->size[a], self->fresh[a]);
}

/* Takes over what is not None: all of it, or nothing. Returns 0 where something is not as step takes it. */
static int change(Follower *self, PyObject *const *objects)
{
    graspforce_place place;
    int given = 0;
    for (int a = 0; a < CHANGING; a++) {
        if (objects[a] == Py_None) continue;
        if (!read_change(self, a, objects[a])) return 0;
        given |= 1 << a;
    }
    const double *R = given >> NOW_R & 1 ? self->fresh[NOW_R] : self->now[NOW_R];
    const double *p = given >> NOW_P & 1 ? self->fresh[NOW_P] : self->now[NOW_P];
    int moved = given >> NOW_P != 0;
    if (given >> NOW_R & 1 && !graspforce_rotations(self->structure.contacts, R)) return 0;
    if (moved && !graspforce_grasp(&self->structure, p, R, self->fresh_G, &place)) return 0;

    for (int a = 0; a < CHANGING; a++) {
        if (!(given >> a & 1)) continue;
        double *before = self->now[a];
        self->now[a] = self->fresh[a], self->fresh[a] = before;
    }
    if (moved) {
        double *before = self->G;
        self->G = self->fresh_G, self->fresh_G = before;
        self->place = place;
    }
    self->changed |= given;
    return 1;
}

/* ---- solving ------------------------------------------------------------------------------------------------------------ */

/* Solves and, where there is an answer and the cones are exact, certifies it. Returns the status; `iterations` and, where it was
 * certified, `residuals`. */
static int solve_and_certify(Follower *self, const graspforce_options *options, int *iterations, graspforce_residuals *residuals)
{
    const graspforce_structure *s = &self->structure;
    double w[6], *const *now = self->now;
    graspforce_about_centroid(&self->place, now[NOW_W], w);
    const graspforce_data data = {
        .G = self->G, .w = w, .mu = now[ITS_MU], .gamma = now[ITS_GAMMA], .min_normal = now[ITS_MIN_NORMAL],
        .max_normal = now[ITS_MAX_NORMAL], .J = now[NOW_J], .tau_u = now[NOW_TAU_U], .lower = now[ITS_LOWER],
        .upper = now[ITS_UPPER], .weight = now[ITS_WEIGHT], .facet = now[ITS_FACET],
        .cost = self->has_cost ? now[ITS_COST] : NULL, .force_weight = self->force_weight,
    };
    graspforce_answer x = {.f = self->answer};
    x.y = x.f + self->k, x.z = x.y + 6, x.nu_lower = x.z + self->k, x.nu_upper = x.nu_lower + s->contacts;
    x.lambda_lower = x.nu_upper + s->contacts, x.lambda_upper = x.lambda_lower + s->joints;
    double *tau = x.lambda_upper + s->joints;

    const graspforce_options own = {options->tolerance, options->max_iterations, options->warm && self->used};
    int status = graspforce_solve(s, &data, &own, self->workspace, &x);
    self->used = 1;
    *iterations = x.iterations;
    if (status > GRASPFORCE_INACCURATE || s->facets > 0) return status;
    graspforce_units units;
    graspforce_scale(s, &data, self->place.length, self->torque, &units);
    graspforce_certify(s, &data, &x, &units, tau, x.z, self->scratch, residuals);
    return status;
}

/* The answer's numbers, then those of the arrays that are not as they were loaded. */
static PyObject *numbers_solved(const Follower *self)
{
    Py_ssize_t count = self->width;
    for (int a = 0; a < CHANGING; a++) count += self->changed >> a & 1 ? self->size[a] : 0;
    PyObject *numbers = PyBytes_FromStringAndSize(NULL, count * (Py_ssize_t)sizeof(double));
    if (numbers == NULL) return NULL;
    char *to = PyBytes_AS_STRING(numbers);
    memcpy(to, self->answer, (size_t)self->width * sizeof(double));
    to += (size_t)self->width * sizeof(double);
    for (int a = 0; a < CHANGING; a++) {
        if (!(self->changed >> a & 1)) continue;
        memcpy(to, self->now[a], (size_t)self->size[a] * sizeof(double));
        to += (size_t)self->size[a] * sizeof(double);
    }
    return numbers;
}

#endif
