/* What a Kernel (_structured.c) holds: a structure of its own, and buffers of the arrays that it is bound to. */
#ifndef GRASPFORCE_STRUCTURED_KERNEL_H
#define GRASPFORCE_STRUCTURED_KERNEL_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "certify.h"
#include "grasp.h"
#include "structured.h"

enum {
    P, R, G, W, MU, GAMMA, MIN_NORMAL, MAX_NORMAL, JACOBIAN, TAU_U, LOWER, UPPER, WEIGHT, FACET, COST, FORCE_WEIGHT,
    UNITS, ANSWER, REPORT, ARRAYS, INPUTS = UNITS
};
enum { SOLVED = 5, REPORT_WIDTH = 8 }; /* status, iterations, primal, dual, gap; certified primal, dual, gap */
enum { INDICES = 4 };

static char *names[] = {"components", "contact_block", "joint_block", "facet_contact", "p",     "R",     "G",      "w",
                        "mu",         "gamma",         "min_normal",  "max_normal",    "J",     "tau_u", "lower",  "upper",
                        "weight",     "facet",         "cost",        "force_weight",  "units", "answer", "report", NULL};

typedef struct {
    PyObject_HEAD
    graspforce_structure structure;
    int *indices;              /* the structure's own integers */
    Py_buffer arrays[ARRAYS];  /* obj is NULL where not held */
    Py_ssize_t stride[ARRAYS]; /* numbers from one problem to the next, 0 where shared */
    Py_ssize_t count;          /* M */
    Py_ssize_t k;
    double *own_G;             /* where p and R are held: G, and w, then are about the contacts' centroid */
    graspforce_place place;
    void *workspace;
    int used;                  /* the workspace has seen a problem */
    double *scratch;           /* (n) for the certificate */
    int bound;                 /* all arrays are held */
    int busy;
} Kernel;

/* Copies an array of C integers to the end of those already copied. Returns its length, or -1 with an exception. */
static Py_ssize_t copy_integers(PyObject *object, const char *name, int **all, Py_ssize_t *used)
{
    Py_buffer view;
    if (PyObject_GetBuffer(object, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return -1;
    Py_ssize_t count = view.len / (Py_ssize_t)sizeof(int);
    if (view.itemsize != (Py_ssize_t)sizeof(int) || view.format == NULL || (view.format[0] != 'i' && view.format[0] != 'l')) {
        PyErr_Format(PyExc_TypeError, "%s must hold C integers (numpy.intc)", name);
        count = -1;
    } else {
        int *larger = PyMem_Realloc(*all, (size_t)(*used + count + 1) * sizeof(int));
        if (larger == NULL) {
            PyErr_NoMemory();
            count = -1;
        } else {
            *all = larger;
            memcpy(larger + *used, view.buf, (size_t)count * sizeof(int));
            *used += count;
        }
    }
    PyBuffer_Release(&view);
    return count;
}

static int read_structure(Kernel *self, PyObject **objects)
{
    Py_ssize_t length[INDICES], used = 0;
    for (int i = 0; i < INDICES; i++)
        if ((length[i] = copy_integers(objects[i], names[i], &self->indices, &used)) < 0) return -1;
    if (length[1] != length[0] || used > INT_MAX) {
        PyErr_SetString(PyExc_ValueError, "contact_block must be as long as components");
        return -1;
    }
    graspforce_structure *s = &self->structure;
    s->contacts = (int)length[0];
    s->joints = (int)length[2];
    s->facets = (int)length[3];
    s->components = self->indices;
    s->contact_block = s->components + length[0];
    s->joint_block = s->contact_block + length[1];
    s->facet_contact = s->joint_block + length[2];
    for (Py_ssize_t i = 0; i < length[1] + length[2]; i++)
        if (s->contact_block[i] >= s->blocks) s->blocks = s->contact_block[i] + 1;
    size_t size = graspforce_workspace_size(s);
    if (size == 0) {
        PyErr_SetString(PyExc_ValueError, "components, contact_block, joint_block and facet_contact describe no hand");
        return -1;
    }
    self->workspace = PyMem_RawMalloc(size);
    self->scratch = PyMem_RawCalloc((size_t)s->joints + 1, sizeof(double));
    if (self->workspace == NULL || self->scratch == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    for (int i = 0; i < s->contacts; i++) self->k += s->components[i];
    return 0;
}

static Py_ssize_t size_of(const Kernel *self, int a)
{
    Py_ssize_t k = self->k, N = self->structure.contacts, n = self->structure.joints, m = self->structure.facets;
    const Py_ssize_t answer = 2 * k + 6 + 2 * N + 3 * n; /* f, y, z, nu_lower, nu_upper, lambda_lower, lambda_upper, torques */
    const Py_ssize_t size[ARRAYS] = {3 * N, 9 * N, 6 * k, 6, N, N, N, N, k * n, n, n, n, n, 4 * m, k, 1,
                                     3 + n, answer, REPORT_WIDTH};
    return size[a];
}

static int may_be_absent(int a)
{
    return a == P || a == R || a == G || a == COST;
}

/* Holds an array of float64: one problem's worth of numbers, or `count` times as many; None where it may be absent. */
static int hold_array(Kernel *self, int a, PyObject *object)
{
    Py_ssize_t size = size_of(self, a);
    Py_buffer view = {.obj = NULL};
    if (object == Py_None && may_be_absent(a)) return 0;
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (a >= UNITS ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, &view, flags) < 0) return -1;
    Py_ssize_t numbers = view.len / (Py_ssize_t)sizeof(double);
    int shared = numbers == size && a < ANSWER, single = a == P || a == R;
    if (a == ANSWER && self->count == 0) self->count = size > 0 && numbers % size == 0 ? numbers / size : 0;
    if (view.itemsize != (Py_ssize_t)sizeof(double) || view.format == NULL || view.format[0] != 'd')
        PyErr_Format(PyExc_TypeError, "%s must hold float64", names[INDICES + a]);
    else if (!shared && (single || self->count < 1 || numbers != size * self->count))
        PyErr_Format(PyExc_ValueError, "%s must hold %zd numbers%s", names[INDICES + a], size,
                     single ? "" : " a problem, for one problem or for each answer");
    else {
        self->arrays[a] = view;
        self->stride[a] = shared ? 0 : size;
        return 0;
    }
    PyBuffer_Release(&view);
    return -1;
}

/* Holds all inputs of the problem or problems, and makes G of p and R. Returns 0, or -1 with an exception. */
static int hold_inputs(Kernel *self, PyObject *const *objects)
{
    for (int a = 0; a < INPUTS; a++)
        if (hold_array(self, a, objects[a]) < 0) return -1;
    if ((objects[P] == Py_None) != (objects[R] == Py_None) || (objects[P] == Py_None) == (objects[G] == Py_None)) {
        PyErr_SetString(PyExc_ValueError, "either G is given, or p and R");
        return -1;
    }
    if (objects[P] == Py_None) return 0;
    self->own_G = PyMem_RawMalloc((size_t)size_of(self, G) * sizeof(double));
    if (self->own_G == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    if (graspforce_grasp(&self->structure, self->arrays[P].buf, self->arrays[R].buf, self->own_G, &self->place)) return 0;
    PyErr_SetString(PyExc_ValueError, "p and R must make a finite G");
    return -1;
}

static int Kernel_init(Kernel *self, PyObject *args, PyObject *kwargs)
{
    PyObject *o[INDICES + ARRAYS];
    if (self->workspace != NULL) {
        PyErr_SetString(PyExc_RuntimeError, "a Kernel is bound once");
        return -1;
    }
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "OOOOOOOOOOOOOOOOOOOOOOO", names, o, o + 1, o + 2, o + 3, o + 4, o + 5, o + 6,
                                     o + 7, o + 8, o + 9, o + 10, o + 11, o + 12, o + 13, o + 14, o + 15, o + 16, o + 17,
                                     o + 18, o + 19, o + 20, o + 21, o + 22))
        return -1;
    if (read_structure(self, o) < 0) return -1;
    if (hold_array(self, ANSWER, o[INDICES + ANSWER]) < 0) return -1; /* first: it says how many problems there are */
    for (int a = UNITS; a < ARRAYS; a++)
        if (a != ANSWER && hold_array(self, a, o[INDICES + a]) < 0) return -1;
    if (hold_inputs(self, o + INDICES) < 0) return -1;
    self->bound = 1;
    return 0;
}

static void Kernel_dealloc(Kernel *self)
{
    PyTypeObject *type = Py_TYPE(self);
    for (int a = 0; a < ARRAYS; a++)
        if (self->arrays[a].obj != NULL) PyBuffer_Release(&self->arrays[a]);
    PyMem_RawFree(self->workspace);
    PyMem_RawFree(self->scratch);
    PyMem_RawFree(self->own_G);
    PyMem_Free(self->indices);
    type->tp_free((PyObject *)self);
    Py_DECREF(type);
}

static double *numbers(const Kernel *self, int a, Py_ssize_t problem)
{
    return (double *)self->arrays[a].buf + self->stride[a] * problem;
}

/* The i-th problem; `w` (6) is where its wrench about the centroid is put. */
static graspforce_data data_of(const Kernel *self, Py_ssize_t i, double *w)
{
    const double *given = numbers(self, W, i);
    if (self->own_G != NULL)
        graspforce_about_centroid(&self->place, given, w);
    else
        memcpy(w, given, 6 * sizeof *w);
    return (graspforce_data){
        .G = self->own_G != NULL ? self->own_G : numbers(self, G, i),
        .w = w,
        .mu = numbers(self, MU, i),
        .gamma = numbers(self, GAMMA, i),
        .min_normal = numbers(self, MIN_NORMAL, i),
        .max_normal = numbers(self, MAX_NORMAL, i),
        .J = numbers(self, JACOBIAN, i),
        .tau_u = numbers(self, TAU_U, i),
        .lower = numbers(self, LOWER, i),
        .upper = numbers(self, UPPER, i),
        .weight = numbers(self, WEIGHT, i),
        .facet = numbers(self, FACET, i),
        .cost = self->arrays[COST].obj != NULL ? numbers(self, COST, i) : NULL,
        .force_weight = *numbers(self, FORCE_WEIGHT, i),
    };
}

static graspforce_answer answer_of(const Kernel *self, Py_ssize_t i)
{
    Py_ssize_t N = self->structure.contacts, n = self->structure.joints;
    graspforce_answer answer = {.f = numbers(self, ANSWER, i)};
    answer.y = answer.f + self->k;
    answer.z = answer.y + 6;
    answer.nu_lower = answer.z + self->k;
    answer.nu_upper = answer.nu_lower + N;
    answer.lambda_lower = answer.nu_upper + N;
    answer.lambda_upper = answer.lambda_lower + n;
    return answer;
}

/* Takes the Kernel for this thread. Returns 0, or -1 with an exception. */
static int take(Kernel *self)
{
    if (!self->bound || self->busy) {
        PyErr_SetString(PyExc_RuntimeError, self->busy ? "this Kernel is at work in another thread" : "this Kernel is not bound");
        return -1;
    }
    self->busy = 1;
    return 0;
}

/* Reads `first` and `last` and takes the Kernel for this thread. Returns 0, or -1 with an exception. */
static int take_range(Kernel *self, PyObject *const *args, Py_ssize_t *first, Py_ssize_t *last)
{
    *first = PyLong_AsSsize_t(args[0]);
    *last = PyLong_AsSsize_t(args[1]);
    if (PyErr_Occurred()) return -1;
    if (*first < 0 || *last > self->count || *first > *last) {
        PyErr_Format(PyExc_ValueError, "0 <= first <= last <= %zd, the number of problems", self->count);
        return -1;
    }
    return take(self);
}

#endif
