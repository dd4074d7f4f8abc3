/* Python's way to structured.h, grasp.h and certify.h: one type, `Kernel`, bound to the caller's arrays and then called with next
 * to nothing.
 *
 * A Kernel reads its problems from, and writes its answers to, the arrays that it holds. Where M problems are stacked along a
 * first axis it solves any range of them; arrays that hold one problem's worth are shared by all. A Kernel of one problem
 * follows it: `step` takes what changed and returns copies that nobody writes to. The interpreter lock is released while it
 * works. One Kernel serves one thread at a time.
 */
#include "_structured_kernel.h"

#include <float.h>
#include <math.h>

enum { MOST_ITERATIONS = 1000 };

static int solve_one(Kernel *self, Py_ssize_t i, const graspforce_options *options)
{
    double w[6];
    graspforce_data data = data_of(self, i, w);
    graspforce_answer answer = answer_of(self, i);
    const graspforce_options own = {options->tolerance, options->max_iterations, options->warm && self->used};
    int status = graspforce_solve(&self->structure, &data, &own, self->workspace, &answer);
    self->used = 1;
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
    double w[6];
    graspforce_data data = data_of(self, i, w);
    graspforce_answer answer = answer_of(self, i);
    double *unit = numbers(self, UNITS, i);
    graspforce_units units = {.force = unit[0], .length = unit[1], .cost = unit[2], .torque = unit + 3};
    if (self->arrays[P].obj != NULL) {
        graspforce_scale(&self->structure, &data, self->place.length, unit + 3, &units);
        unit[0] = units.force, unit[1] = units.length, unit[2] = units.cost;
    }
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

/* ---- one problem that changes ------------------------------------------------------------------------------------------- */

enum { CHANGING = 5 };
static const int changing[CHANGING] = {W, JACOBIAN, TAU_U, P, R};

/* A copy, as bytes, of an array of float64 of the shape that step takes, all finite. NULL without exception for all else. */
static PyObject *finite_copy(const Kernel *self, int a, PyObject *object)
{
    const Py_ssize_t N = self->structure.contacts, n = self->structure.joints;
    const Py_ssize_t shape[CHANGING][3] = {{6}, {self->k, n}, {n}, {N, 3}, {N, 3, 3}};
    static const int dimensions[CHANGING] = {1, 2, 1, 2, 3};
    Py_buffer view;
    if (PyObject_GetBuffer(object, &view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) {
        PyErr_Clear();
        return NULL;
    }
    int fits = view.format != NULL && strcmp(view.format, "d") == 0 && view.ndim == dimensions[a] && view.len > 0;
    for (int d = 0; fits && d < view.ndim; d++) fits = view.shape[d] == shape[a][d];
    PyObject *copy = fits ? PyBytes_FromStringAndSize(NULL, view.len) : NULL;
    if (copy != NULL && PyBuffer_ToContiguous(PyBytes_AS_STRING(copy), &view, view.len, 'C') < 0) Py_CLEAR(copy);
    PyBuffer_Release(&view);
    if (copy == NULL) return NULL;
    const double *x = (const double *)PyBytes_AS_STRING(copy);
    Py_ssize_t count = PyBytes_GET_SIZE(copy) / (Py_ssize_t)sizeof(double);
    int finite = 1;
    for (Py_ssize_t i = 0; i < count; i++) finite &= fabs(x[i]) <= DBL_MAX;
    if (!finite) Py_CLEAR(copy);
    return copy;
}

/* Copies what changed into `fresh`, and G with its place where p or R did. Returns 0 where something is not as step takes it. */
static int read_changes(Kernel *self, PyObject *const *objects, PyObject **fresh, PyObject **matrix, graspforce_place *place)
{
    for (int c = 0; c < CHANGING; c++)
        if (objects[c] != Py_None && (fresh[c] = finite_copy(self, c, objects[c])) == NULL) return 0;
    if (fresh[3] == NULL && fresh[4] == NULL) return 1;
    if (self->arrays[P].obj == NULL) return 0;
    const double *p = fresh[3] ? (const double *)PyBytes_AS_STRING(fresh[3]) : self->arrays[P].buf;
    const double *frames = fresh[4] ? (const double *)PyBytes_AS_STRING(fresh[4]) : self->arrays[R].buf;
    if (fresh[4] != NULL && !graspforce_rotations(self->structure.contacts, frames)) return 0;
    *matrix = grasp_matrix(self, p, frames, place);
    return *matrix != NULL;
}

/* Takes over what changed: all of it, or nothing. Returns 1, or 0 where it is not as step takes it, or -1 with an exception. */
static int change(Kernel *self, PyObject *const *objects)
{
    PyObject *fresh[CHANGING] = {NULL}, *matrix = NULL;
    graspforce_place place;
    int result = read_changes(self, objects, fresh, &matrix, &place);
    if (result == 1) {
        for (int c = 0; c < CHANGING; c++)
            if (fresh[c] != NULL && hold_bytes(self, changing[c], fresh[c]) < 0) result = -1;
        if (matrix != NULL && hold_bytes(self, G, matrix) < 0) result = -1;
        if (matrix != NULL) self->place = place;
    } else if (PyErr_Occurred())
        result = -1;
    for (int c = 0; c < CHANGING; c++) Py_XDECREF(fresh[c]);
    Py_XDECREF(matrix);
    return result;
}

/* What step returns. */
static PyObject *stepped(const Kernel *self, int status, int measured)
{
    const double *report = numbers(self, REPORT, 0);
    const Py_buffer *answer = &self->arrays[ANSWER];
    PyObject *held = PyTuple_New(CHANGING), *result = PyTuple_New(5);
    if (held == NULL || result == NULL) goto failed;
    for (int c = 0; c < CHANGING; c++) {
        PyObject *own = self->arrays[changing[c]].obj;
        PyTuple_SET_ITEM(held, c, Py_NewRef(own != NULL ? own : Py_None));
    }
    PyTuple_SET_ITEM(result, 0, PyLong_FromLong(status));
    PyTuple_SET_ITEM(result, 1, PyLong_FromLong((long)report[1]));
    PyTuple_SET_ITEM(result, 2, measured ? Py_BuildValue("ddd", report[5], report[6], report[7]) : Py_NewRef(Py_None));
    PyTuple_SET_ITEM(result, 3, PyBytes_FromStringAndSize(answer->buf, answer->len));
    PyTuple_SET_ITEM(result, 4, held);
    if (!PyErr_Occurred()) return result;
    held = NULL;
failed:
    Py_XDECREF(held);
    Py_XDECREF(result);
    return NULL;
}

PyDoc_STRVAR(step_doc,
             "step(tolerance, max_iterations, warm, w, J, tau_u, p, R)\n--\n\n"
             "Changes what is not None, solves the problem and, where there is an answer and the cones are exact, certifies it.\n"
             "Returns status, iterations, the certificate's residuals (None where it was not measured), `answer` as bytes, and\n"
             "the w, J, tau_u, p and R that were solved, as they are held. Returns None, and changes nothing, unless what is\n"
             "given are arrays of finite float64 in the shapes (6,), (k, n), (n,), (N, 3), (N, 3, 3) with n > 0, the last\n"
             "holding rotations to 1e-10.");

static PyObject *Kernel_step(Kernel *self, PyObject *const *args, Py_ssize_t count)
{
    graspforce_options options;
    if (count != 3 + CHANGING) {
        PyErr_SetString(PyExc_TypeError, "step takes tolerance, max_iterations, warm, w, J, tau_u, p, R");
        return NULL;
    }
    if (self->count != 1) {
        PyErr_SetString(PyExc_ValueError, "only a Kernel of one problem steps");
        return NULL;
    }
    if (read_options(args, &options) < 0 || take(self) < 0) return NULL;
    PyObject *result = NULL;
    int changed = change(self, args + 3);
    if (changed == 1) {
        int status, measured;
        Py_BEGIN_ALLOW_THREADS
        status = solve_one(self, 0, &options);
        measured = status <= 1 && self->structure.facets == 0;
        if (measured) certify_one(self, 0);
        Py_END_ALLOW_THREADS
        result = stepped(self, status, measured);
    } else if (changed == 0)
        result = Py_NewRef(Py_None);
    self->busy = 0;
    return result;
}

PyDoc_STRVAR(load_doc,
             "load(p, R, G, w, mu, gamma, min_normal, max_normal, J, tau_u, lower, upper, weight, facet, cost, force_weight)\n"
             "--\n\n"
             "Holds other arrays of the same sizes.");

static PyObject *Kernel_load(Kernel *self, PyObject *const *args, Py_ssize_t count)
{
    if (count != INPUTS) {
        PyErr_Format(PyExc_TypeError, "load takes %d arrays", INPUTS);
        return NULL;
    }
    if (take(self) < 0) return NULL;
    int held = hold_inputs(self, args);
    self->busy = 0;
    if (held < 0) return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {{"solve", (PyCFunction)(void (*)(void))Kernel_solve, METH_FASTCALL, solve_doc},
                                {"step", (PyCFunction)(void (*)(void))Kernel_step, METH_FASTCALL, step_doc},
                                {"load", (PyCFunction)(void (*)(void))Kernel_load, METH_FASTCALL, load_doc},
                                {"certify", (PyCFunction)(void (*)(void))Kernel_certify, METH_FASTCALL, certify_doc},
                                {NULL, NULL, 0, NULL}};

PyDoc_STRVAR(kernel_doc,
             "Kernel(components, contact_block, joint_block, facet_contact, p, R, G, w, mu, gamma, min_normal, max_normal, J,\n"
             "tau_u, lower, upper, weight, facet, cost, force_weight, units, answer, report)\n--\n\n"
             "The structured kernel bound to arrays, which it reads and writes at every call. structured.h says what each\n"
             "holds; the first four are numpy.intc and copied, the others contiguous float64 and kept; cost may be None. With\n"
             "contact positions p and frames R, G is None and w about O: G, w about the centroid and `units` are made of them.\n"
             "With G, p and R are None, w is about G's point, and `units` are read. `units` are F, L, the cost's and each\n"
             "motor's T, for `certify`. `answer` holds a problem's f, y, z, nu_lower, nu_upper, lambda_lower, lambda_upper and\n"
             "torques one after the other; `report` its status, iterations, primal, dual and gap as the kernel saw them, then\n"
             "primal, dual and gap as `certify` measured them.");

static PyType_Slot slots[] = {
    {Py_tp_doc, (void *)kernel_doc}, {Py_tp_new, PyType_GenericNew}, {Py_tp_init, Kernel_init}, {Py_tp_dealloc, Kernel_dealloc},
    {Py_tp_methods, methods},        {0, NULL},
};
static PyType_Spec spec = {"graspforce.backends._structured.Kernel", sizeof(Kernel), 0, Py_TPFLAGS_DEFAULT, slots};

PyDoc_STRVAR(fingers_doc,
             "fingers(components, J, contact_block, joint_block)\n--\n\n"
             "Writes the block of each contact and of each joint and returns the force components of the largest. J is (k, n)\n"
             "float64, the others are C integers, all contiguous.");

static PyObject *fingers(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    static const char *const format[] = {"i", "d", "i", "i"};
    Py_buffer view[4];
    int held = 0, fits = count == 4, largest = 0;
    for (; fits && held < 4; held++) {
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (held >= 2 ? PyBUF_WRITABLE : 0);
        if (PyObject_GetBuffer(args[held], &view[held], flags) < 0) break;
        fits = view[held].ndim == (held == 1 ? 2 : 1) && view[held].format != NULL && strcmp(view[held].format, format[held]) == 0;
    }
    if (held == 4 && fits) {
        const Py_ssize_t N = view[0].shape[0], n = view[3].shape[0];
        const int *components = view[0].buf;
        Py_ssize_t k = 0;
        for (Py_ssize_t i = 0; i < N; i++) k += components[i] > 0 ? components[i] : INT_MAX;
        fits = view[1].shape[0] == k && view[1].shape[1] == n && view[2].shape[0] == N && n < INT_MAX;
        if (fits) graspforce_fingers((int)N, components, (int)n, view[1].buf, view[2].buf, view[3].buf, &largest);
    }
    for (int i = 0; i < held; i++) PyBuffer_Release(&view[i]);
    if (PyErr_Occurred()) return NULL;
    if (fits) return PyLong_FromLong(largest);
    PyErr_SetString(PyExc_ValueError, "fingers takes C integers (N,), float64 with a row for each component, C integers (N,), (n,)");
    return NULL;
}

static PyMethodDef functions[] = {{"fingers", (PyCFunction)(void (*)(void))fingers, METH_FASTCALL, fingers_doc},
                                  {NULL, NULL, 0, NULL}};

static int execute(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&spec);
    if (type == NULL) return -1;
    int result = PyModule_AddObjectRef(module, "Kernel", type);
    Py_DECREF(type);
    return result;
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, execute}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_structured", .m_size = 0,
                                        .m_methods = functions, .m_slots = module_slots};

PyMODINIT_FUNC PyInit__structured(void)
{
    return PyModuleDef_Init(&definition);
}
