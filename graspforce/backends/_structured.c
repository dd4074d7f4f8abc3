/* Python's way to structured.h: one type, `Kernel`, bound once to the caller's arrays and then called with next to nothing.
 *
 * A Kernel reads its problems from, and writes its answers to, the arrays that it was made with: whoever wants another problem
 * writes into them. Where M problems are stacked along a first axis it solves any range of them; arrays that hold one problem's
 * worth are shared by all. The interpreter lock is released while it works. One Kernel serves one thread at a time.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "certify.h"
#include "structured.h"

enum {
    G, W, MU, GAMMA, MIN_NORMAL, MAX_NORMAL, JACOBIAN, TAU_U, LOWER, UPPER, WEIGHT, FACET, COST, FORCE_WEIGHT, UNITS,
    ANSWER, REPORT, ARRAYS
};
enum { SOLVED = 5, REPORT_WIDTH = 8 }; /* status, iterations, primal, dual, gap; certified primal, dual, gap */
enum { INDICES = 4, MOST_ITERATIONS = 1000 };

static char *names[] = {"components", "contact_block", "joint_block", "facet_contact", "G",      "w",     "mu",
                        "gamma",      "min_normal",    "max_normal",  "J",             "tau_u",  "lower", "upper",
                        "weight",     "facet",         "cost",        "force_weight",  "units",  "answer", "report", NULL};

typedef struct {
    PyObject_HEAD
    graspforce_structure structure;
    int *indices;              /* the structure's own integers */
    Py_buffer arrays[ARRAYS];  /* obj is NULL where not held */
    Py_ssize_t stride[ARRAYS]; /* numbers from one problem to the next, 0 where shared */
    Py_ssize_t count;          /* M */
    Py_ssize_t k;
    void *workspace;
    double *scratch;           /* (n) for the certificate */
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
    self->workspace = PyMem_RawCalloc(1, size);
    self->scratch = PyMem_RawCalloc((size_t)s->joints + 1, sizeof(double));
    if (self->workspace == NULL || self->scratch == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    for (int i = 0; i < s->contacts; i++) self->k += s->components[i];
    return 0;
}

/* Holds an array of float64: one problem's worth of numbers, or `count` times as many. */
static int hold_array(Kernel *self, int a, PyObject *object, Py_ssize_t size)
{
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (a >= ANSWER ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, &self->arrays[a], flags) < 0) return -1;
    Py_buffer *view = &self->arrays[a];
    if (view->itemsize != (Py_ssize_t)sizeof(double) || view->format == NULL || view->format[0] != 'd') {
        PyErr_Format(PyExc_TypeError, "%s must hold float64", names[INDICES + a]);
        return -1;
    }
    Py_ssize_t numbers = view->len / (Py_ssize_t)sizeof(double);
    if (a == ANSWER) self->count = size > 0 && numbers % size == 0 ? numbers / size : 0;
    if (self->count > 0 && numbers == size * self->count)
        self->stride[a] = size;
    else if (numbers != size || a >= ANSWER) {
        PyErr_Format(PyExc_ValueError, "%s must hold %zd numbers a problem, for one problem or for each answer",
                     names[INDICES + a], size);
        return -1;
    }
    return 0;
}

static int Kernel_init(Kernel *self, PyObject *args, PyObject *kwargs)
{
    PyObject *o[INDICES + ARRAYS];
    if (self->workspace != NULL) {
        PyErr_SetString(PyExc_RuntimeError, "a Kernel is bound once");
        return -1;
    }
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "OOOOOOOOOOOOOOOOOOOOO", names, o, o + 1, o + 2, o + 3, o + 4, o + 5, o + 6,
                                     o + 7, o + 8, o + 9, o + 10, o + 11, o + 12, o + 13, o + 14, o + 15, o + 16, o + 17,
                                     o + 18, o + 19, o + 20))
        return -1;
    if (read_structure(self, o) < 0) return -1;
    Py_ssize_t k = self->k, N = self->structure.contacts, n = self->structure.joints, m = self->structure.facets;
    const Py_ssize_t answer = 2 * k + 6 + 2 * N + 3 * n; /* f, y, z, nu_lower, nu_upper, lambda_lower, lambda_upper, torques */
    const Py_ssize_t size[ARRAYS] = {6 * k, 6, N, N, N, N, k * n, n, n, n, n, 4 * m, k, 1, 3 + n, answer, REPORT_WIDTH};
    PyObject **arrays = o + INDICES;
    if (hold_array(self, ANSWER, arrays[ANSWER], size[ANSWER]) < 0) return -1; /* first: it says how many problems there are */
    for (int a = 0; a < ARRAYS; a++)
        if (a != ANSWER && hold_array(self, a, arrays[a], size[a]) < 0) return -1;
    return 0;
}

static void Kernel_dealloc(Kernel *self)
{
    PyTypeObject *type = Py_TYPE(self);
    for (int a = 0; a < ARRAYS; a++)
        if (self->arrays[a].obj != NULL) PyBuffer_Release(&self->arrays[a]);
    PyMem_RawFree(self->workspace);
    PyMem_RawFree(self->scratch);
    PyMem_Free(self->indices);
    type->tp_free((PyObject *)self);
    Py_DECREF(type);
}

static double *numbers(const Kernel *self, int a, Py_ssize_t problem)
{
    return (double *)self->arrays[a].buf + self->stride[a] * problem;
}

static graspforce_data data_of(const Kernel *self, Py_ssize_t i)
{
    return (graspforce_data){
        .G = numbers(self, G, i),
        .w = numbers(self, W, i),
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
        .cost = numbers(self, COST, i),
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
    if (self->scratch == NULL || self->busy) {
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

static int solve_one(Kernel *self, Py_ssize_t i, const graspforce_options *options)
{
    graspforce_data data = data_of(self, i);
    graspforce_answer answer = answer_of(self, i);
    int status = graspforce_solve(&self->structure, &data, options, self->workspace, &answer);
    double *report = numbers(self, REPORT, i);
    report[0] = status;
    report[1] = answer.iterations;
    report[2] = answer.primal;
    report[3] = answer.dual;
    report[4] = answer.gap;
    return status;
}

static void certify_one(Kernel *self, Py_ssize_t i)
{
    graspforce_data data = data_of(self, i);
    graspforce_answer answer = answer_of(self, i);
    const double *unit = numbers(self, UNITS, i);
    graspforce_units units = {.force = unit[0], .length = unit[1], .cost = unit[2], .torque = unit + 3};
    graspforce_residuals residuals;
    double *tau = answer.lambda_upper + self->structure.joints, *report = numbers(self, REPORT, i) + SOLVED;
    graspforce_certify(&self->structure, &data, &answer, &units, tau, answer.z, self->scratch, &residuals);
    report[0] = residuals.primal;
    report[1] = residuals.dual;
    report[2] = residuals.gap;
}

/* Reads tolerance, max_iterations and warm. Returns 0, or -1 with an exception. */
static int read_options(PyObject *const *args, graspforce_options *options)
{
    long most = PyLong_AsLong(args[1]);
    options->tolerance = PyFloat_AsDouble(args[0]);
    options->warm = PyObject_IsTrue(args[2]);
    if (PyErr_Occurred()) return -1;
    if (most < 1 || most > MOST_ITERATIONS || !(options->tolerance > 0.0)) {
        PyErr_Format(PyExc_ValueError, "tolerance > 0 and 1 <= max_iterations <= %d", MOST_ITERATIONS);
        return -1;
    }
    options->max_iterations = (int)most;
    return 0;
}

PyDoc_STRVAR(solve_doc,
             "solve(first, last, tolerance, max_iterations, warm)\n--\n\n"
             "Solves problems first <= i < last in order and returns the worst status among them: 0 optimal, 1 inaccurate,\n"
             "2 infeasible, 3 failed. A warm start begins at the last answer of this Kernel.");

static PyObject *Kernel_solve(Kernel *self, PyObject *const *args, Py_ssize_t count)
{
    if (count != 5) {
        PyErr_SetString(PyExc_TypeError, "solve takes first, last, tolerance, max_iterations, warm");
        return NULL;
    }
    graspforce_options options;
    if (read_options(args + 2, &options) < 0) return NULL;
    Py_ssize_t first, last;
    if (take_range(self, args, &first, &last) < 0) return NULL;
    int worst = 0;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = first; i < last; i++) {
        int status = solve_one(self, i, &options);
        worst = status > worst ? status : worst;
    }
    Py_END_ALLOW_THREADS
    self->busy = 0;
    return PyLong_FromLong(worst);
}

PyDoc_STRVAR(certify_doc,
             "certify(first, last)\n--\n\n"
             "Measures the answers of problems first <= i < last as certify.h says, from f, y, nu and lambda alone. Writes\n"
             "z and the torques into `answer` and the residuals into `report`. Exact cones only.");

static PyObject *Kernel_certify(Kernel *self, PyObject *const *args, Py_ssize_t count)
{
    Py_ssize_t first, last;
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "certify takes first, last");
        return NULL;
    }
    if (self->structure.facets > 0) {
        PyErr_SetString(PyExc_ValueError, "certify knows exact cones only");
        return NULL;
    }
    if (take_range(self, args, &first, &last) < 0) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = first; i < last; i++) certify_one(self, i);
    Py_END_ALLOW_THREADS
    self->busy = 0;
    Py_RETURN_NONE;
}

PyDoc_STRVAR(step_doc,
             "step(tolerance, max_iterations, warm)\n--\n\n"
             "Solves the first problem and, where there is an answer and the cones are exact, certifies it. Returns status,\n"
             "iterations, and the certificate's primal and dual residual and gap, None where it was not measured.");

static PyObject *Kernel_step(Kernel *self, PyObject *const *args, Py_ssize_t count)
{
    graspforce_options options;
    if (count != 3) {
        PyErr_SetString(PyExc_TypeError, "step takes tolerance, max_iterations, warm");
        return NULL;
    }
    if (read_options(args, &options) < 0 || take(self) < 0) return NULL;
    int status, measured;
    Py_BEGIN_ALLOW_THREADS
    status = solve_one(self, 0, &options);
    measured = status <= 1 && self->structure.facets == 0;
    if (measured) certify_one(self, 0);
    Py_END_ALLOW_THREADS
    self->busy = 0;
    const double *report = numbers(self, REPORT, 0);
    if (measured) return Py_BuildValue("ii(ddd)", status, (int)report[1], report[5], report[6], report[7]);
    return Py_BuildValue("iiO", status, (int)report[1], Py_None);
}

static PyMethodDef methods[] = {{"solve", (PyCFunction)(void (*)(void))Kernel_solve, METH_FASTCALL, solve_doc},
                                {"step", (PyCFunction)(void (*)(void))Kernel_step, METH_FASTCALL, step_doc},
                                {"certify", (PyCFunction)(void (*)(void))Kernel_certify, METH_FASTCALL, certify_doc},
                                {NULL, NULL, 0, NULL}};

PyDoc_STRVAR(kernel_doc,
             "Kernel(components, contact_block, joint_block, facet_contact, G, w, mu, gamma, min_normal, max_normal, J,\n"
             "tau_u, lower, upper, weight, facet, cost, force_weight, units, answer, report)\n--\n\n"
             "The structured kernel bound to arrays, which it reads and writes at every `solve`. structured.h says what each\n"
             "holds; the first four are numpy.intc and copied, the others contiguous float64 and kept. `units` are F, L, the\n"
             "cost's and each motor's T, for `certify`. `answer` holds a problem's f, y, z, nu_lower, nu_upper, lambda_lower,\n"
             "lambda_upper and torques one after the other; `report` its status, iterations, primal, dual and gap as the\n"
             "kernel saw them, then primal, dual and gap as `certify` measured them.");

static PyType_Slot slots[] = {
    {Py_tp_doc, (void *)kernel_doc}, {Py_tp_new, PyType_GenericNew}, {Py_tp_init, Kernel_init}, {Py_tp_dealloc, Kernel_dealloc},
    {Py_tp_methods, methods},        {0, NULL},
};
static PyType_Spec spec = {"graspforce.backends._structured.Kernel", sizeof(Kernel), 0, Py_TPFLAGS_DEFAULT, slots};

static int execute(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&spec);
    if (type == NULL) return -1;
    int result = PyModule_AddObjectRef(module, "Kernel", type);
    Py_DECREF(type);
    return result;
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, execute}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_structured", .m_size = 0, .m_slots = module_slots};

PyMODINIT_FUNC PyInit__structured(void)
{
    return PyModuleDef_Init(&definition);
}
