/* Python's way to structured.h, grasp.h and certify.h, by two types. The interpreter lock is released while they work. Each
 * serves one thread at a time.
 *
 * A Kernel is bound to the caller's arrays: it reads its problems from them and writes its answers to them. Where M problems are
 * stacked along a first axis it solves any range of them; arrays that hold one problem's worth are shared by all.
 *
 * A Follower keeps one problem: `step` takes what changed and returns the answer's numbers, which nobody writes to.
 */
#include "array_kernel.inc"
#include "incremental_kernel.inc"

enum { MAX_ITERATIONS = 1000 };

static int solve_one(Kernel *self, Py_ssize_t i, const gf_options *options)
{
    double w[6];
    gf_problem data = problem_at(self, i, w);
    gf_solution answer = solution_at(self, i);
    const gf_options own = {options->tolerance, options->max_iterations, options->warm && self->used};
    int status = gf_solve(&self->structure, &data, &own, self->workspace, &answer);
    self->used = 1;
    double *report = array_at(self, KERNEL_REPORT, i);
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
    gf_problem data = problem_at(self, i, w);
    gf_solution answer = solution_at(self, i);
    double *unit = array_at(self, KERNEL_UNITS, i);
    gf_units units = {.force = unit[0], .length = unit[1], .cost = unit[2], .torque = unit + 3};
    if (self->own_G != NULL) {
        gf_problem_units(&self->structure, &data, self->place.length, unit + 3, &units);
        unit[0] = units.force, unit[1] = units.length, unit[2] = units.cost;
    }
    gf_residuals residuals;
    double *tau = answer.lambda_upper + self->structure.joints, *report = array_at(self, KERNEL_REPORT, i) + SOLVED;
    gf_certify(&self->structure, &data, &answer, &units, tau, answer.z, self->scratch, &residuals);
    report[0] = residuals.primal;
    report[1] = residuals.dual;
    report[2] = residuals.gap;
}

/* Reads tolerance, max_iterations and warm. Returns 0, or -1 with an exception. */
static int read_options(PyObject *const *args, gf_options *options)
{
    long most = PyLong_AsLong(args[1]);
    options->tolerance = PyFloat_AsDouble(args[0]);
    options->warm = PyObject_IsTrue(args[2]);
    if (PyErr_Occurred()) return -1;
    if (most < 1 || most > MAX_ITERATIONS || !(options->tolerance > 0.0)) {
        PyErr_Format(PyExc_ValueError, "tolerance > 0 and 1 <= max_iterations <= %d", MAX_ITERATIONS);
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
    gf_options options;
    if (read_options(args + 2, &options) < 0) return NULL;
    Py_ssize_t first, last;
    if (acquire_range(self, args, &first, &last) < 0) return NULL;
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
    if (acquire_range(self, args, &first, &last) < 0) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = first; i < last; i++) certify_one(self, i);
    Py_END_ALLOW_THREADS
    self->busy = 0;
    Py_RETURN_NONE;
}

static PyMethodDef Kernel_methods[] = {{"solve", (PyCFunction)(void (*)(void))Kernel_solve, METH_FASTCALL, solve_doc},
                                       {"certify", (PyCFunction)(void (*)(void))Kernel_certify, METH_FASTCALL, certify_doc},
                                       {NULL, NULL, 0, NULL}};

PyDoc_STRVAR(
    kernel_doc,
    "Kernel(components, contact_block, joint_block, facet_contact, p, R, G, w, mu, gamma, min_normal, max_normal, J,\n"
    "tau_u, lower, upper, weight, facet, cost, force_weight, units, answer, report)\n--\n\n"
    "The structured kernel bound to arrays, which it reads and writes at every call. structured.h says what each\n"
    "holds; the first four are numpy.intc and copied, the others contiguous float64 and kept; cost may be None. With\n"
    "contact positions p and frames R, G is None and w about O: G, w about the centroid and `units` are made of them.\n"
    "With G, p and R are None, w is about G's point, and `units` are read. `units` are F, L, the cost's and each\n"
    "motor's T, for `certify`. `answer` holds a problem's f, y, z, nu_lower, nu_upper, lambda_lower, lambda_upper and\n"
    "torques one after the other; `report` its status, iterations, primal, dual and gap as the kernel saw them, then\n"
    "primal, dual and gap as `certify` measured them.");

static PyType_Slot Kernel_slots[] = {
    {Py_tp_doc, (void *)kernel_doc}, {Py_tp_new, PyType_GenericNew},  {Py_tp_init, Kernel_init},
    {Py_tp_dealloc, Kernel_dealloc}, {Py_tp_methods, Kernel_methods}, {0, NULL},
};
static PyType_Spec Kernel_spec = {"graspforce.force.backends._structured.Kernel", sizeof(Kernel), 0, Py_TPFLAGS_DEFAULT,
                                  Kernel_slots};

/* A tuple that takes over its items. NULL where one of them is. */
static PyObject *tuple_of(Py_ssize_t count, PyObject **items)
{
    PyObject *tuple = PyTuple_New(count);
    int whole = tuple != NULL;
    for (Py_ssize_t i = 0; i < count; i++) {
        whole &= items[i] != NULL;
        if (tuple != NULL)
            PyTuple_SET_ITEM(tuple, i, items[i]);
        else
            Py_XDECREF(items[i]);
    }
    if (!whole) Py_CLEAR(tuple);
    return tuple;
}

static PyObject *three_numbers(double a, double b, double c)
{
    PyObject *items[3] = {PyFloat_FromDouble(a), PyFloat_FromDouble(b), PyFloat_FromDouble(c)};
    return tuple_of(3, items);
}

/* ---- one problem that changes ------------------------------------------------------------------------------------------- */

/* Takes the Follower for this thread. Returns 0, or -1 with an exception. */
static int acquire_incremental(IncrementalKernel *self)
{
    if (self->busy || !self->loaded) {
        PyErr_SetString(PyExc_RuntimeError, self->busy ? "this Follower is at work in another thread" : "no problem is loaded");
        return -1;
    }
    self->busy = 1;
    return 0;
}

PyDoc_STRVAR(
    step_doc,
    "step(tolerance, max_iterations, warm, w, J, tau_u, p, R)\n--\n\n"
    "Changes what is not None, solves the problem and, where there is an answer and the cones are exact, certifies it.\n"
    "Returns status, iterations, the certificate's residuals (None where it was not measured), numbers and changed.\n"
    "`numbers` are, as bytes, the answer's f, y, z, nu_lower, nu_upper, lambda_lower, lambda_upper and torques, then\n"
    "each of w, J, tau_u, p and R that is not as it was loaded: bits 0 to 4 of `changed` say which. J is what stands\n"
    "within `spans()`, row after row. A warm start begins at the last answer of this Follower.\n"
    "Returns None, and changes nothing, unless what is given are arrays of finite float64 in the shapes (6,), (k, n),\n"
    "(n,), (N, 3), (N, 3, 3) with n > 0, J zero outside its spans and R rotations to 1e-10.");

static PyObject *IncrementalKernel_step(IncrementalKernel *self, PyObject *const *args, Py_ssize_t count)
{
    gf_options options;
    if (count != 3 + CHANGEABLE_COUNT) {
        PyErr_SetString(PyExc_TypeError, "step takes tolerance, max_iterations, warm, w, J, tau_u, p, R");
        return NULL;
    }
    if (read_options(args, &options) < 0 || acquire_incremental(self) < 0) return NULL;
    if (!apply_changes(self, args + 3)) {
        self->busy = 0;
        Py_RETURN_NONE;
    }
    gf_residuals residuals;
    int status, iterations;
    Py_BEGIN_ALLOW_THREADS
    status = solve_and_certify(self, &options, &iterations, &residuals);
    Py_END_ALLOW_THREADS
    int measured = status <= GF_INACCURATE && self->structure.facets == 0;
    PyObject *items[5] = {PyLong_FromLong(status), PyLong_FromLong(iterations),
                          measured ? three_numbers(residuals.primal, residuals.dual, residuals.gap) : Py_NewRef(Py_None),
                          solution_bytes(self), PyLong_FromLong(self->changed)};
    self->busy = 0;
    return tuple_of(5, items);
}

PyDoc_STRVAR(
    load_doc,
    "load(w, J, tau_u, p, R, mu, gamma, min_normal, max_normal, lower, upper, weight, facet, cost, force_weight)\n--\n\n"
    "Copies the numbers of another problem of the same shape. Returns False, and changes nothing, where its J is not zero\n"
    "outside the spans.");

static PyObject *IncrementalKernel_load(IncrementalKernel *self, PyObject *const *args, Py_ssize_t count)
{
    if (count != ARRAY_COUNT + 1) {
        PyErr_Format(PyExc_TypeError, "load takes %d arrays and force_weight", ARRAY_COUNT);
        return NULL;
    }
    if (self->busy) {
        (void)acquire_incremental(self);
        return NULL;
    }
    self->busy = 1;
    int loaded = load(self, args);
    self->busy = 0;
    return loaded < 0 ? NULL : PyBool_FromLong(loaded);
}

PyDoc_STRVAR(spans_doc,
             "spans()\n--\n\nC integers (k, 2) as bytes: row c of J is kept from column (c, 0) to before column (c, 1).");

static PyObject *IncrementalKernel_spans(IncrementalKernel *self, PyObject *none)
{
    (void)none;
    return PyBytes_FromStringAndSize((const char *)self->structure.span, 2 * self->k * (Py_ssize_t)sizeof(int));
}

/* An array's buffer; an empty one for None. Returns 0, or -1 with an exception where it is another kind of array. */
static int get_array(PyObject *object, const char *name, int dimensions, const char *formats, Py_ssize_t itemsize,
                     Py_buffer *view)
{
    view->obj = NULL;
    if (object == Py_None) return 0;
    if (PyObject_GetBuffer(object, view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return -1;
    if (view->ndim == dimensions && view->itemsize == itemsize && view->format != NULL &&
        strchr(formats, view->format[0]) != NULL)
        return 0;
    PyErr_Format(PyExc_ValueError, "%s must be contiguous, of %d dimensions, of type %s", name, dimensions, formats);
    return -1;
}

static PyObject *IncrementalKernel_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    if (PyTuple_GET_SIZE(args) != 3 + ARRAY_COUNT + 1 || (kwargs != NULL && PyDict_GET_SIZE(kwargs) > 0)) {
        PyErr_Format(PyExc_TypeError, "Follower takes most, columns, facet_contact and what load takes");
        return NULL;
    }
    PyObject *const *given = &PyTuple_GET_ITEM(args, 0);
    IncrementalKernel *self = (IncrementalKernel *)type->tp_alloc(type, 0);
    if (self == NULL) return NULL;
    Py_buffer columns = {.obj = NULL}, facets = {.obj = NULL}, J = {.obj = NULL};
    long most = PyLong_AsLong(given[0]);
    int made = !PyErr_Occurred() && get_array(given[1], "columns", 1, "lq", sizeof(Py_ssize_t), &columns) == 0 &&
               get_array(given[2], "facet_contact", 1, "il", sizeof(int), &facets) == 0 &&
               get_array(given[3 + ARRAY_J], "J", 2, "d", sizeof(double), &J) == 0 && columns.obj != NULL &&
               find_structure(self, (int)most, &columns, &J, &facets) == 0 && allocate_numbers(self) == 0 &&
               load(self, given + 3) == 1;
    if (columns.obj != NULL) PyBuffer_Release(&columns);
    if (facets.obj != NULL) PyBuffer_Release(&facets);
    if (J.obj != NULL) PyBuffer_Release(&J);
    if (made) return (PyObject *)self;
    if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "columns must be given");
    Py_DECREF(self);
    return NULL;
}

static void IncrementalKernel_dealloc(IncrementalKernel *self)
{
    PyTypeObject *type = Py_TYPE(self);
    PyMem_RawFree(self->memory);
    PyMem_Free(self->indices);
    type->tp_free((PyObject *)self);
    Py_DECREF(type);
}

static PyMethodDef IncrementalKernel_methods[] = {
    {"step", (PyCFunction)(void (*)(void))IncrementalKernel_step, METH_FASTCALL, step_doc},
    {"load", (PyCFunction)(void (*)(void))IncrementalKernel_load, METH_FASTCALL, load_doc},
    {"spans", (PyCFunction)IncrementalKernel_spans, METH_NOARGS, spans_doc},
    {NULL, NULL, 0, NULL}};

PyDoc_STRVAR(
    follower_doc,
    "Follower(most, columns, facet_contact, w, J, tau_u, p, R, mu, gamma, min_normal, max_normal, lower, upper, weight,\n"
    "facet, cost, force_weight)\n--\n\n"
    "The structured kernel with a problem of its own. structured.h says what each array holds, but for `columns` (k,)\n"
    "intp, where each stacked force component stands among the 4 N padded ones, contact positions p and frames R, and w\n"
    "about O. All are copied. J and the other arrays of the hand are None where there is none, facet_contact and facet\n"
    "without pyramids, cost without linear cost, weight where torques cost nothing. The fingers are the connected\n"
    "components of J; OverflowError where one has more than `most` force components.");

static PyType_Slot IncrementalKernel_slots[] = {
    {Py_tp_doc, (void *)follower_doc},
    {Py_tp_new, IncrementalKernel_new},
    {Py_tp_dealloc, IncrementalKernel_dealloc},
    {Py_tp_methods, IncrementalKernel_methods},
    {0, NULL},
};
static PyType_Spec IncrementalKernel_spec = {"graspforce.force.backends._structured.IncrementalKernel",
                                             sizeof(IncrementalKernel), 0, Py_TPFLAGS_DEFAULT, IncrementalKernel_slots};

PyDoc_STRVAR(fingers_doc,
             "fingers(components, J, contact_block, joint_block)\n--\n\n"
             "Writes the block of each contact and of each joint and returns the force components of the largest. J is (k, n)\n"
             "float64, the others are C integers, all contiguous.");

static PyObject *find_fingers(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    static const char *const format[] = {"i", "d", "i", "i"};
    Py_buffer view[4];
    int held = 0, fits = count == 4, largest = 0;
    for (; fits && held < 4; held++) {
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (held >= 2 ? PyBUF_WRITABLE : 0);
        if (PyObject_GetBuffer(args[held], &view[held], flags) < 0) break;
        fits = view[held].ndim == (held == 1 ? 2 : 1) && view[held].format != NULL &&
               strcmp(view[held].format, format[held]) == 0;
    }
    if (held == 4 && fits) {
        const Py_ssize_t N = view[0].shape[0], n = view[3].shape[0];
        const int *components = view[0].buf;
        Py_ssize_t k = 0;
        for (Py_ssize_t i = 0; i < N; i++) k += components[i] > 0 ? components[i] : INT_MAX;
        fits = view[1].shape[0] == k && view[1].shape[1] == n && view[2].shape[0] == N && n < INT_MAX;
        if (fits) gf_find_fingers((int)N, components, (int)n, view[1].buf, view[2].buf, view[3].buf, &largest);
    }
    for (int i = 0; i < held; i++) PyBuffer_Release(&view[i]);
    if (PyErr_Occurred()) return NULL;
    if (fits) return PyLong_FromLong(largest);
    PyErr_SetString(PyExc_ValueError,
                    "fingers takes C integers (N,), float64 with a row for each component, C integers (N,), (n,)");
    return NULL;
}

PyDoc_STRVAR(
    record_doc,
    "record(type, names, *values)\n--\n\n"
    "An instance of a frozen class with its attributes set, as object.__new__ and object.__setattr__ make it, in a third of\n"
    "the time.");

static PyObject *make_record(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    if (count < 2 || !PyType_Check(args[0]) || !PyTuple_Check(args[1]) || PyTuple_GET_SIZE(args[1]) != count - 2 ||
        ((PyTypeObject *)args[0])->tp_new != PyBaseObject_Type.tp_new) {
        PyErr_SetString(PyExc_TypeError, "record takes a class that object.__new__ makes, names, and a value for each");
        return NULL;
    }
    PyObject *none = PyTuple_New(0), *made = none ? PyBaseObject_Type.tp_new((PyTypeObject *)args[0], none, NULL) : NULL;
    Py_XDECREF(none);
    for (Py_ssize_t i = 0; made != NULL && i < count - 2; i++)
        if (PyObject_GenericSetAttr(made, PyTuple_GET_ITEM(args[1], i), args[2 + i]) < 0) Py_CLEAR(made);
    return made;
}

static PyMethodDef functions[] = {{"find_fingers", (PyCFunction)(void (*)(void))find_fingers, METH_FASTCALL, fingers_doc},
                                  {"make_record", (PyCFunction)(void (*)(void))make_record, METH_FASTCALL, record_doc},
                                  {NULL, NULL, 0, NULL}};

static int execute(PyObject *module)
{
    PyType_Spec *specs[] = {&Kernel_spec, &IncrementalKernel_spec};
    static const char *const type_names[] = {"Kernel", "IncrementalKernel"};
    for (int i = 0; i < 2; i++) {
        PyObject *type = PyType_FromSpec(specs[i]);
        int result = type == NULL ? -1 : PyModule_AddObjectRef(module, type_names[i], type);
        Py_XDECREF(type);
        if (result < 0) return -1;
    }
    return 0;
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, execute}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_structured", .m_size = 0, .m_methods = functions,
                                        .m_slots = module_slots};

PyMODINIT_FUNC PyInit__structured(void)
{
    return PyModuleDef_Init(&definition);
}
