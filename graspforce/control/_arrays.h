/* What Python hands to the laws: arrays of float64, each of one right shape. */
#ifndef GRASPFORCE_ARRAYS_H
#define GRASPFORCE_ARRAYS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <string.h>

#include "../shapes/feet.h"

/* What an array of float64 must look like. */
typedef struct {
    const char *name;
    int dimensions;
    Py_ssize_t shape[3]; /* ANY for any */
} looks;

enum { ANY = -1, MOST_ARRAYS = 11 };

/* The arrays that a function reads and, last, writes. */
typedef struct {
    int count;
    Py_buffer views[MOST_ARRAYS];
} arrays;

static void release(arrays *a)
{
    while (a->count > 0) PyBuffer_Release(&a->views[--a->count]);
}

/* Views one more array, of any strides. Returns 0, or -1 with an exception. */
static int hold(arrays *a, PyObject *object, looks must)
{
    Py_buffer *view = &a->views[a->count];
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return -1;
    a->count++;
    int fits = view->format != NULL && strcmp(view->format, "d") == 0 && view->ndim == must.dimensions;
    for (int d = 0; fits && d < must.dimensions; d++) fits = must.shape[d] == ANY || view->shape[d] == must.shape[d];
    if (!fits) PyErr_Format(PyExc_ValueError, "%s must be float64 of the right shape", must.name);
    return fits ? 0 : -1;
}

/* The same of a contiguous array. Returns its numbers, or NULL with an exception. */
static const double *hold_block(arrays *a, PyObject *object, looks must)
{
    if (hold(a, object, must) < 0) return NULL;
    const Py_buffer *view = &a->views[a->count - 1];
    if (PyBuffer_IsContiguous(view, 'C')) return view->buf;
    PyErr_Format(PyExc_ValueError, "%s must be contiguous", must.name);
    return NULL;
}

/* Views so many numbers, whatever the array calls them; `access` is 0 or PyBUF_WRITABLE. */
static double *hold_numbers_of(arrays *a, PyObject *object, Py_ssize_t count, int access)
{
    Py_buffer *view = &a->views[a->count];
    if (PyObject_GetBuffer(object, view, PyBUF_C_CONTIGUOUS | access) < 0) return NULL;
    a->count++;
    if (view->len == count * (Py_ssize_t)sizeof(double)) return view->buf;
    PyErr_Format(PyExc_ValueError, "answer must have room for %zd numbers", count);
    return NULL;
}

/* Views the array to write to. */
static double *hold_answer(arrays *a, PyObject *object, Py_ssize_t count)
{
    return hold_numbers_of(a, object, count, PyBUF_WRITABLE);
}

/* The number at [i], [i, j] or [i, j, k]. */
static double at(const Py_buffer *v, Py_ssize_t i, Py_ssize_t j, Py_ssize_t k)
{
    const Py_ssize_t *s = v->strides;
    return *(const double *)((const char *)v->buf + i * s[0] + (v->ndim > 1 ? j * s[1] : 0) + (v->ndim > 2 ? k * s[2] : 0));
}

/* Copies an array of any strides. Returns 0, or -1 with an exception. */
static int take(PyObject *object, looks must, double *to)
{
    arrays a = {.count = 0};
    const int held = hold(&a, object, must);
    if (held == 0) {
        const Py_buffer *v = a.views;
        const Py_ssize_t *shape = v->shape;
        if (PyBuffer_IsContiguous(v, 'C')) {
            memcpy(to, v->buf, (size_t)v->len);
        } else {
            const Py_ssize_t rows = v->ndim > 1 ? shape[1] : 1, columns = v->ndim > 2 ? shape[2] : 1;
            for (Py_ssize_t i = 0; i < shape[0]; i++)
                for (Py_ssize_t j = 0; j < rows; j++)
                    for (Py_ssize_t k = 0; k < columns; k++) *to++ = at(v, i, j, k);
        }
    }
    release(&a);
    return held;
}

/* Reads form, (kind, size, size, size). Returns 0, or -1 with an exception. */
static int read_surface(PyObject *form, surface *shape)
{
    if (!PyTuple_Check(form)) {
        PyErr_SetString(PyExc_TypeError, "form must be a tuple");
        return -1;
    }
    double *size = shape->size;
    if (!PyArg_ParseTuple(form, "iddd", &shape->kind, &size[0], &size[1], &size[2])) return -1;
    if (shape->kind >= FLAT && shape->kind <= BOX) return 0;
    PyErr_SetString(PyExc_ValueError, "form: no such shape");
    return -1;
}

#endif
