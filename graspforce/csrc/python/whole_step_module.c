/* The Python module graspforce.core._whole_step: whole control steps, and the answers of streams that are made of them. */
#include "stream_step_type.inc"
#include "whole_step_type.inc"

/* Add the types to the module. Return 0, or -1 with an exception. */
static int gf_py_add_types(PyObject *module)
{
    return gf_py_add_whole_step(module) < 0 ? -1 : gf_py_add_stream_step(module);
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)gf_py_add_types}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_whole_step", .m_size = 0, .m_slots = slots};

PyMODINIT_FUNC PyInit__whole_step(void)
{
    return PyModuleDef_Init(&definition);
}
