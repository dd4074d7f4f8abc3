/* Python's way to the laws: plain functions to rolling.h and mobility.h, from arrays of float64 to one that the caller brings,
 * and a type, `Step`, to step.h. Nothing is kept between calls but the numbers of the hold that a Step was made of. */
#include "control_step_type.inc"

static void read_vector(const Py_buffer *v, Py_ssize_t i, vector x)
{
    for (int k = 0; k < 3; k++) x[k] = at(v, i, k, 0);
}

static void read_matrix(const Py_buffer *v, Py_ssize_t i, matrix R)
{
    for (int k = 0; k < 9; k++) R[k] = at(v, i, k / 3, k % 3);
}

/* ---- rolling ------------------------------------------------------------------------------------------------------------ */

PyDoc_STRVAR(roll_doc,
             "roll(form, p_HF, R_HF, rates, radii, p_HO, R_HO, twist, p_OC, R_OC, R_before, answer)\n--\n\n"
             "Writes the N contacts of fingertips on an object, as rolling.h says, to `answer`: p_OC (N, 3), R_OC (N, 3, 3),\n"
             "A (3 N, n), B (3 N, 6), beta (3 N,), velocity (N, 3), gap (N,), p_OF (N, 3), R_OF (N, 3, 3) and the spins'\n"
             "A (N, n), B (N, 6) and beta (N,), one after the other. form is Shape.closed_form; p_OC and R_OC are the hold's.");

enum { P_HF, R_HF, RATES, RADII, P_HO, R_HO, TWIST, P_HOLD, R_HOLD, R_BEFORE, TIP_ARRAYS };
enum { PER_CONTACT = 56, PER_RATE = 4, PARTS = 12 }; /* `answer` holds 56 N + 4 N n numbers in twelve parts */

/* Views what roll reads. Returns the number of joints n, or -1 with an exception. */
static Py_ssize_t hold_tips(arrays *a, PyObject *const *objects)
{
    const looks first = {"p_HF", 2, {ANY, 3}};
    if (hold(a, objects[P_HF], first) < 0) return -1;
    const Py_ssize_t N = a->views[P_HF].shape[0];
    const looks must[TIP_ARRAYS] = {
        first, {"R_HF", 3, {N, 3, 3}}, {"rates", 3, {N, 6, ANY}}, {"radii", 1, {N}}, {"p_HO", 1, {3}}, {"R_HO", 2, {3, 3}},
        {"twist", 1, {6}}, {"p_OC", 2, {N, 3}}, {"R_OC", 3, {N, 3, 3}}, {"R_before", 3, {N, 3, 3}},
    };
    for (int i = R_HF; i < TIP_ARRAYS; i++) {
        if (i == RATES ? hold_block(a, objects[i], must[i]) == NULL : hold(a, objects[i], must[i]) < 0) return -1;
    }
    if (a->views[RATES].shape[2] >= 2) return a->views[RATES].shape[2] - 2;
    PyErr_SetString(PyExc_ValueError, "rates must hold J, twist and drift");
    return -1;
}

static void roll_all(const arrays *a, const surface *shape, Py_ssize_t n, double *answer)
{
    const Py_buffer *v = a->views;
    const Py_ssize_t N = v[P_HF].shape[0], size[PARTS] = {3, 9, 3 * n, 18, 3, 3, 1, 3, 9, n, 6, 1};
    held_object object = {.shape = *shape};
    for (int k = 0; k < 3; k++) object.p_HO[k] = at(&v[P_HO], k, 0, 0);
    for (int k = 0; k < 9; k++) object.R_HO[k] = at(&v[R_HO], k / 3, k % 3, 0);
    for (int k = 0; k < 6; k++) object.twist[k] = at(&v[TWIST], k, 0, 0);
    to_O(object.R_HO, object.twist + 3, object.omega);
    for (Py_ssize_t i = 0; i < N; i++) {
        touching_tip tip = {.radius = at(&v[RADII], i, 0, 0), .rates = (const double *)v[RATES].buf + 6 * (n + 2) * i};
        read_vector(&v[P_HF], i, tip.p_HF);
        read_matrix(&v[R_HF], i, tip.R_HF);
        read_vector(&v[P_HOLD], i, tip.p_hold);
        read_matrix(&v[R_HOLD], i, tip.R_hold);
        read_matrix(&v[R_BEFORE], i, tip.before);
        double *own[PARTS], *part = answer;
        for (int p = 0; p < PARTS; part += N * size[p++]) own[p] = part + i * size[p];
        const rolling_contact contact = {own[0], own[1], own[2], own[3], own[4],  own[5],
                                         own[6], own[7], own[8], own[9], own[10], own[11]};
        roll(&object, &tip, (int)n, &contact);
    }
}

static PyObject *laws_roll(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    if (count != TIP_ARRAYS + 2) {
        PyErr_SetString(PyExc_TypeError, "roll takes a form, ten arrays and answer");
        return NULL;
    }
    surface shape;
    if (read_surface(args[0], &shape) < 0) return NULL;
    arrays a = {.count = 0};
    const Py_ssize_t n = hold_tips(&a, args + 1);
    if (n >= 0) {
        double *answer = hold_answer(&a, args[1 + TIP_ARRAYS], (PER_CONTACT + PER_RATE * n) * a.views[P_HF].shape[0]);
        if (answer != NULL) roll_all(&a, &shape, n, answer);
    }
    release(&a);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

PyDoc_STRVAR(slid_doc,
             "slid(p_OF, R_OF, p_OC, p_OF_now, R_OF_now, R_OC_now, answer)\n--\n\n"
             "Writes to `answer`, (N, 2), how far fingertips slid between two instants along t₁ and t₂ of R_OC_now, m.");

enum { THEN, R_THEN, TOUCHED, NOW, R_NOW, R_OC_NOW, SLID_ARRAYS };

static PyObject *laws_slid(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    if (count != SLID_ARRAYS + 1) {
        PyErr_SetString(PyExc_TypeError, "slid takes six arrays and answer");
        return NULL;
    }
    arrays a = {.count = 0};
    const Py_buffer *v = a.views;
    Py_ssize_t N = ANY;
    for (int i = 0; i < SLID_ARRAYS; i++) {
        const int turns = i == R_THEN || i >= R_NOW;
        if (hold(&a, args[i], (looks){"each array", turns ? 3 : 2, {N, 3, 3}}) < 0) goto done;
        N = v[0].shape[0];
    }
    double *answer = hold_answer(&a, args[SLID_ARRAYS], 2 * N);
    for (Py_ssize_t i = 0; answer != NULL && i < N; i++) {
        vector p_then, touched, p_now;
        matrix R_then, R_now, R_OC;
        read_vector(&v[THEN], i, p_then);
        read_vector(&v[TOUCHED], i, touched);
        read_vector(&v[NOW], i, p_now);
        read_matrix(&v[R_THEN], i, R_then);
        read_matrix(&v[R_NOW], i, R_now);
        read_matrix(&v[R_OC_NOW], i, R_OC);
        slide(p_then, R_then, touched, p_now, R_now, R_OC, answer + 2 * i);
    }
done:
    release(&a);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

/* ---- mobility ----------------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(keep_contacts_doc,
             "keep_contacts(A, B, beta, wanted, posture, least_lever, answer)\n--\n\n"
             "Writes to `answer`, (n,), the joint accelerations of mobility.h and returns True; returns False where some\n"
             "direction may be one in which the joints hardly move a contact. A (r, n), B (r, 6), beta (r,), wanted (6,) and\n"
             "posture (n,) are contiguous.");

static PyObject *laws_keep_contacts(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    (void)module;
    if (count != 7) {
        PyErr_SetString(PyExc_TypeError, "keep_contacts takes five arrays, least_lever and answer");
        return NULL;
    }
    const double least_lever = PyFloat_AsDouble(args[5]), *given[5];
    if (PyErr_Occurred()) return NULL;
    arrays a = {.count = 0};
    double *work = NULL, *answer;
    int every_way = 0;
    if ((given[0] = hold_block(&a, args[0], (looks){"A", 2, {ANY, ANY}})) == NULL) goto done;
    const Py_ssize_t r = a.views[0].shape[0], n = a.views[0].shape[1];
    const looks must[] = {{"B", 2, {r, 6}}, {"beta", 1, {r}}, {"wanted", 1, {6}}, {"posture", 1, {n}}};
    for (int i = 1; i < 5; i++)
        if ((given[i] = hold_block(&a, args[i], must[i - 1])) == NULL) goto done;
    if ((answer = hold_answer(&a, args[6], n)) == NULL) goto done;
    if ((work = PyMem_Malloc((size_t)(r * (r + 1)) * sizeof(double))) == NULL)
        PyErr_NoMemory();
    else
        every_way = keep_contacts((int)r, (int)n, given[0], given[1], given[2], given[3], given[4], least_lever, work, answer);
done:
    PyMem_Free(work);
    release(&a);
    if (PyErr_Occurred()) return NULL;
    return PyBool_FromLong(every_way);
}

/* ---- the module --------------------------------------------------------------------------------------------------------- */

static PyMethodDef functions[] = {
    {"roll", (PyCFunction)(void (*)(void))laws_roll, METH_FASTCALL, roll_doc},
    {"slip_displacement", (PyCFunction)(void (*)(void))laws_slid, METH_FASTCALL, slid_doc},
    {"keep_contacts", (PyCFunction)(void (*)(void))laws_keep_contacts, METH_FASTCALL, keep_contacts_doc},
    {NULL, NULL, 0, NULL},
};
static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)add_step}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_native", .m_size = 0, .m_methods = functions,
                                        .m_slots = slots};

PyMODINIT_FUNC PyInit__native(void)
{
    return PyModuleDef_Init(&definition);
}
