/* The Python module graspforce.force.backends._structured: the solver and the certificate of graspforce/solve.h.
 *
 *     Kernel               solves any range of M stacked problems in the caller's arrays
 *     IncrementalKernel    solves one problem of its own, of which each step changes a part
 *
 * Both release the interpreter lock while they solve. One kernel serves one thread at a time.
 */
#include "array_kernel_type.inc"
#include "graspforce/version.h"
#include "incremental_kernel_type.inc"
#include "rigorous_function.inc"
#include "shifted_functions.inc"

PyDoc_STRVAR(
    find_fingers_doc,
    "find_fingers(components, J, contact_block, joint_block)\n--\n\n"
    "Find the fingers: write the block of each contact and motor. Return the force components of the largest finger.\n\n"
    "J is float64 (k, n). The others are C integers (N,), (N,) and (n,). All are C-contiguous.");

static PyObject *find_fingers(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    static const char *const format[] = {"i", "d", "i", "i"};
    Py_buffer view[4];
    int acquired = 0, fits = count == 4, largest = 0;
    for (; fits && acquired < 4; acquired++) {
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (acquired >= 2 ? PyBUF_WRITABLE : 0);
        Py_buffer *v = &view[acquired];
        if (PyObject_GetBuffer(args[acquired], v, flags) < 0) break;
        fits = v->ndim == (acquired == 1 ? 2 : 1) && v->format != NULL && strcmp(v->format, format[acquired]) == 0;
    }
    if (acquired == 4 && fits) {
        const Py_ssize_t N = view[0].shape[0], n = view[3].shape[0];
        const int *components = view[0].buf;
        Py_ssize_t k = 0;
        for (Py_ssize_t i = 0; i < N; i++) k += components[i] > 0 ? components[i] : INT_MAX;
        fits = view[1].shape[0] == k && view[1].shape[1] == n && view[2].shape[0] == N && n < INT_MAX;
        if (fits) gf_find_fingers((int)N, components, (int)n, view[1].buf, view[2].buf, view[3].buf, &largest);
    }
    for (int i = 0; i < acquired; i++) PyBuffer_Release(&view[i]);
    if (PyErr_Occurred()) return NULL;
    if (fits) return PyLong_FromLong(largest);
    PyErr_SetString(PyExc_ValueError, "find_fingers takes C integers (N,), float64 (k, n) with a row for each component, "
                                      "and C integers (N,) and (n,)");
    return NULL;
}

PyDoc_STRVAR(make_record_doc, "make_record(type, names, *values)\n--\n\n"
                              "Return an instance of a frozen class with these attributes, without calling its __init__.\n\n"
                              "It is equivalent to object.__new__ and object.__setattr__, but faster.");

static PyObject *make_record(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    if (count < 2 || !PyType_Check(args[0]) || !PyTuple_Check(args[1]) || PyTuple_GET_SIZE(args[1]) != count - 2 ||
        ((PyTypeObject *)args[0])->tp_new != PyBaseObject_Type.tp_new) {
        PyErr_SetString(PyExc_TypeError,
                        "make_record takes a class without __new__, a tuple of names, and a value for each name");
        return NULL;
    }
    PyObject *none = PyTuple_New(0), *made = none ? PyBaseObject_Type.tp_new((PyTypeObject *)args[0], none, NULL) : NULL;
    Py_XDECREF(none);
    for (Py_ssize_t i = 0; made != NULL && i < count - 2; i++)
        if (PyObject_GenericSetAttr(made, PyTuple_GET_ITEM(args[1], i), args[2 + i]) < 0) Py_CLEAR(made);
    return made;
}

static PyMethodDef functions[] = {
    {"find_fingers", (PyCFunction)(void (*)(void))find_fingers, METH_FASTCALL, find_fingers_doc},
    {"certify_rigorously", (PyCFunction)(void (*)(void))certify_rigorously, METH_FASTCALL, certify_rigorously_doc},
    {"shift_problem", (PyCFunction)(void (*)(void))shift_problem, METH_FASTCALL, shift_problem_doc},
    {"check_shifted", (PyCFunction)(void (*)(void))check_shifted, METH_FASTCALL, check_shifted_doc},
    {"make_record", (PyCFunction)(void (*)(void))make_record, METH_FASTCALL, make_record_doc},
    {NULL, NULL, 0, NULL}};

/* Add an object under a name; the reference is taken over. Return 0, or −1 with an exception. */
static int add_object(PyObject *module, const char *name, PyObject *object)
{
    int result = object == NULL ? -1 : PyModule_AddObjectRef(module, name, object);
    Py_XDECREF(object);
    return result;
}

/* Return the fields of a report as a tuple of pairs (name, type code). */
static PyObject *make_report_fields(void)
{
    const Py_ssize_t count = sizeof report_fields / sizeof *report_fields;
    PyObject *fields = PyTuple_New(count);
    for (Py_ssize_t i = 0; fields != NULL && i < count; i++) {
        PyObject *pair = Py_BuildValue("(ss)", report_fields[i][0], report_fields[i][1]);
        if (pair == NULL)
            Py_CLEAR(fields);
        else
            PyTuple_SET_ITEM(fields, i, pair);
    }
    return fields;
}

static int execute(PyObject *module)
{
    gf_result_types *results = PyModule_GetState(module);
    results->step = PyStructSequence_NewType(&step_description);
    results->residuals = PyStructSequence_NewType(&residuals_description);
    if (results->step == NULL || results->residuals == NULL) return -1;
    for (int part = 0; part < PART_COUNT; part++)
        if ((results->part_names[part] = PyUnicode_InternFromString(part_names[part])) == NULL) return -1;
    if (add_object(module, "StepResult", Py_NewRef((PyObject *)results->step)) < 0 ||
        add_object(module, "Residuals", Py_NewRef((PyObject *)results->residuals)) < 0 ||
        add_object(module, "Kernel", PyType_FromModuleAndSpec(module, &Kernel_spec, NULL)) < 0 ||
        add_object(module, "IncrementalKernel", PyType_FromModuleAndSpec(module, &IncrementalKernel_spec, NULL)) < 0 ||
        add_object(module, "report_fields", make_report_fields()) < 0)
        return -1;
    return PyModule_AddStringConstant(module, "__version__", gf_version());
}

static int clear_module(PyObject *module)
{
    gf_result_types *results = PyModule_GetState(module);
    Py_CLEAR(results->step);
    Py_CLEAR(results->residuals);
    for (int part = 0; part < PART_COUNT; part++) Py_CLEAR(results->part_names[part]);
    return 0;
}

static int traverse_module(PyObject *module, visitproc visit, void *arg)
{
    gf_result_types *results = PyModule_GetState(module);
    Py_VISIT(results->step);
    Py_VISIT(results->residuals);
    return 0;
}

static void free_module(void *module)
{
    (void)clear_module(module);
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, execute}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT,
                                        .m_name = "_structured",
                                        .m_doc = "Compiled solver and certificate for grasp force problems.",
                                        .m_size = sizeof(gf_result_types),
                                        .m_methods = functions,
                                        .m_slots = module_slots,
                                        .m_traverse = traverse_module,
                                        .m_clear = clear_module,
                                        .m_free = free_module};

PyMODINIT_FUNC PyInit__structured(void)
{
    return PyModuleDef_Init(&definition);
}
