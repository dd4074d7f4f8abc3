/* Python's way to step.h: the type Step, which keeps a hold's numbers, checked once; nothing in it ever changes. */
#ifndef GRASPFORCE_PYTHON_STEP_H
#define GRASPFORCE_PYTHON_STEP_H

#include "_arrays.h"
#include "step.h"

typedef struct {
    PyObject_HEAD
    hold_numbers hold;
    double *numbers;
    int *indices; /* links, tied and force, then `moved` */
} Step;

/* ---- making one --------------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(step_doc,
             "Step(form, settings, radii, p_OC, R_OC, q, reach, p_LF, R_LF, T, tau_limits, at_limits, q_limits, moved, links, tied,\n"
             "     force)\n--\n\n"
             "The arithmetic of a controller's step for one hold, as step.h says. form is Shape.closed_form; settings (43,) are\n"
             "kp, kd, ki (6 each), the integral's limits (2), posture stiffness and damping, least lever, period, kept creep,\n"
             "creep limit, touch gap, gravity (3), the body's mass, inertia (9) and centre (3). The others are arrays of float64:\n"
             "radii (N,), p_OC (N, 3), R_OC (N, 3, 3), q and reach (n,), p_LF (N, 3), R_LF (N, 3, 3), T (full, n), three (2, n), moved\n"
             "(N, full), links (N,), tied (r,) and force (k,).");

enum { I_SETTINGS, I_RADII, I_P, I_R, I_Q, I_REACH, I_P_LF, I_R_LF, I_T, I_TAU, I_AT, I_ENDS, I_MOVED, I_LINKS, I_TIED, I_FORCE,
       ITS };
enum { SETTINGS = 43, MOST = 1 << 12 }; /* contacts, motors, joints: more would be no hand */

/* The whole numbers in 0 … most − 1 that an array holds. Returns 0, or -1 with an exception. */
static int as_indices(const double *x, int count, int most, const char *name, int *to)
{
    for (int i = 0; i < count; i++) {
        if (!(x[i] >= 0.0 && x[i] < most)) {
            PyErr_Format(PyExc_ValueError, "%s must be indices", name);
            return -1;
        }
        to[i] = (int)x[i];
    }
    return 0;
}

static void put_settings(hold_numbers *h, const double *x)
{
    memcpy(h->kp, x, sizeof h->kp);
    memcpy(h->kd, x + 6, sizeof h->kd);
    memcpy(h->ki, x + 12, sizeof h->ki);
    memcpy(h->integral_limits, x + 18, sizeof h->integral_limits);
    h->stiffness = x[20], h->damping = x[21], h->least_lever = x[22];
    h->period = x[23], h->kept_creep = x[24], h->creep_limit = x[25], h->touch_gap = x[26];
    memcpy(h->gravity_H, x + 27, sizeof h->gravity_H);
    h->mass = x[30];
    memcpy(h->inertia, x + 31, sizeof h->inertia);
    memcpy(h->p_OM, x + 40, sizeof h->p_OM);
}

/* Takes all arrays of a hold whose N, n, full, r and k are known. Returns 0, or -1 with an exception. */
static int take_hold(Step *self, PyObject *const *objects)
{
    hold_numbers *h = &self->hold;
    const int N = h->N, n = h->n, full = h->full, r = h->r, k = h->k;
    const looks must[ITS] = {
        {"settings", 1, {SETTINGS}}, {"radii", 1, {N}}, {"p_OC", 2, {N, 3}}, {"R_OC", 3, {N, 3, 3}}, {"q", 1, {n}},
        {"reach", 1, {n}}, {"p_LF", 2, {N, 3}}, {"R_LF", 3, {N, 3, 3}}, {"T", 2, {full, n}}, {"tau_limits", 2, {2, n}}, {"at_limits", 2, {2, n}},
        {"q_limits", 2, {2, n}}, {"moved", 2, {N, full}}, {"links", 1, {N}}, {"tied", 1, {r}}, {"force", 1, {k}},
    };
    size_t offsets[ITS + 1] = {0};
    for (int i = 0; i < ITS; i++) {
        size_t count = 1;
        for (int d = 0; d < must[i].dimensions; d++) count *= (size_t)must[i].shape[d];
        offsets[i + 1] = offsets[i] + count;
    }
    self->numbers = PyMem_Malloc((offsets[ITS] + 1) * sizeof(double));
    self->indices = PyMem_Malloc((size_t)(N + r + k + 1) * sizeof(int) + (size_t)(N * full));
    if (self->numbers == NULL || self->indices == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    double *x[ITS];
    for (int i = 0; i < ITS; i++) {
        x[i] = self->numbers + offsets[i];
        if (take(objects[i], must[i], x[i]) < 0) return -1;
    }
    put_settings(h, x[I_SETTINGS]);
    h->radii = x[I_RADII], h->p_hold = x[I_P], h->R_hold = x[I_R], h->q_hold = x[I_Q], h->reach = x[I_REACH];
    h->p_LF = x[I_P_LF], h->R_LF = x[I_R_LF], h->T = x[I_T];
    h->tau_limits = x[I_TAU], h->at_limits = x[I_AT], h->q_limits = x[I_ENDS];
    int *link = self->indices, *tied = link + N, *force = tied + r;
    unsigned char *moved = (unsigned char *)(force + k);
    for (int i = 0; i < N * full; i++) moved[i] = x[I_MOVED][i] != 0.0;
    h->link = link, h->tied = tied, h->force = force, h->moved = moved;
    if (as_indices(x[I_LINKS], N, MOST, "links", link) < 0) return -1;
    return as_indices(x[I_TIED], r, 4 * N, "tied", tied) < 0 ? -1 : as_indices(x[I_FORCE], k, 4 * N, "force", force);
}

/* How long an array is along one of its axes, at most MOST. Returns -1 with an exception. */
static int length_of(PyObject *object, looks must, int axis)
{
    arrays a = {.count = 0};
    Py_ssize_t length = hold(&a, object, must) < 0 ? -1 : a.views[0].shape[axis];
    release(&a);
    if (length <= MOST) return (int)length;
    PyErr_Format(PyExc_ValueError, "%s is too long", must.name);
    return -1;
}

static PyObject *step_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    if (PyTuple_GET_SIZE(args) != 1 + ITS || (keywords != NULL && PyDict_GET_SIZE(keywords) > 0)) {
        PyErr_SetString(PyExc_TypeError, "Step takes a form and sixteen arrays");
        return NULL;
    }
    PyObject *objects[ITS];
    for (int i = 0; i < ITS; i++) objects[i] = PyTuple_GET_ITEM(args, 1 + i);
    hold_numbers h = {0};
    if (read_surface(PyTuple_GET_ITEM(args, 0), &h.shape) < 0) return NULL;
    if ((h.N = length_of(objects[I_RADII], (looks){"radii", 1, {ANY}}, 0)) < 0) return NULL;
    if ((h.full = length_of(objects[I_T], (looks){"T", 2, {ANY, ANY}}, 0)) < 0) return NULL;
    if ((h.n = length_of(objects[I_T], (looks){"T", 2, {ANY, ANY}}, 1)) < 0) return NULL;
    if ((h.r = length_of(objects[I_TIED], (looks){"tied", 1, {ANY}}, 0)) < 0) return NULL;
    if ((h.k = length_of(objects[I_FORCE], (looks){"force", 1, {ANY}}, 0)) < 0) return NULL;
    Step *self = (Step *)type->tp_alloc(type, 0);
    if (self == NULL) return NULL;
    self->hold = h;
    if (take_hold(self, objects) == 0) return (PyObject *)self;
    Py_DECREF(self);
    return NULL;
}

static void step_free(Step *self)
{
    PyTypeObject *type = Py_TYPE(self);
    PyMem_Free(self->numbers);
    PyMem_Free(self->indices);
    type->tp_free((PyObject *)self);
    Py_DECREF(type);
}

/* ---- what is wanted ----------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(want_doc,
             "want(q, v, p_HO, R_HO, twist, p_d, R_d, twist_d, a_d, q_d, v_d, q_dd, integral, R_before, external, J, dJ, places,\n"
             "     answer)\n--\n\n"
             "Writes to `answer` the error (6,), the acceleration in H (6,) and in O (6,), w (6,), the joints' (n,), J (k, n), and\n"
             "the parts of `roll`, one after the other. Returns False, joints and w not written, where some direction may be one\n"
             "in which the joints hardly move a contact. J and dJ (6, full) are twists at H's origin for each unit joint rate, and\n"
             "their time derivatives; `places` is a tuple with p_HL (3,) and R_HL (3, 3) of every link; external is None or (6,). q_d, v_d and q_dd\n"
             "(n,) say where the joints should be; None for the hold's posture, and for rest.");

enum { W_Q, W_V, W_P, W_R, W_TWIST, W_P_D, W_R_D, W_TWIST_D, W_A_D, W_Q_D, W_V_D, W_Q_DD, W_INTEGRAL, W_BEFORE, W_EXTERNAL,
       W_J, W_DJ, W_PLACES, W_ANSWER, WANT_ARGUMENTS };

/* The places of the links that carry the tips, (N, 12). Returns 0, or -1 with an exception. */
static int take_places(const hold_numbers *h, PyObject *places, double *to)
{
    if (!PyTuple_Check(places)) {
        PyErr_SetString(PyExc_TypeError, "places must be a tuple");
        return -1;
    }
    for (int i = 0; i < h->N; i++, to += 12) {
        const Py_ssize_t at = 2 * (Py_ssize_t)h->link[i];
        if (at + 1 >= PyTuple_GET_SIZE(places)) {
            PyErr_SetString(PyExc_ValueError, "places must hold every link's");
            return -1;
        }
        if (take(PyTuple_GET_ITEM(places, at), (looks){"p_HL", 1, {3}}, to) < 0) return -1;
        if (take(PyTuple_GET_ITEM(places, at + 1), (looks){"R_HL", 2, {3, 3}}, to + 3) < 0) return -1;
    }
    return 0;
}

/* Takes what a step is told, what is long into `room`. Returns 0, or -1 with an exception. */
static int take_told(const hold_numbers *h, PyObject *const *args, double *room, told *now)
{
    const int N = h->N, n = h->n, full = h->full;
    double *q = room, *v = q + n, *rates = v + n, *R_before = rates + full, *J = R_before + 9 * N, *dJ = J + 6 * full;
    double *place = dJ + 6 * full, *joints_d = place + 12 * N;
    const struct { int at; looks must; double *to; } all[] = {
        {W_Q, {"q", 1, {n}}, q}, {W_V, {"v", 1, {n}}, v}, {W_P, {"p_HO", 1, {3}}, now->p_HO},
        {W_R, {"R_HO", 2, {3, 3}}, now->R_HO}, {W_TWIST, {"twist", 1, {6}}, now->twist}, {W_P_D, {"p_d", 1, {3}}, now->p_d},
        {W_R_D, {"R_d", 2, {3, 3}}, now->R_d}, {W_TWIST_D, {"twist_d", 1, {6}}, now->twist_d},
        {W_A_D, {"a_d", 1, {6}}, now->a_d}, {W_INTEGRAL, {"integral", 1, {6}}, now->integral},
        {W_BEFORE, {"R_before", 3, {N, 3, 3}}, R_before}, {W_J, {"J", 2, {6, full}}, J}, {W_DJ, {"dJ", 2, {6, full}}, dJ},
    };
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (take(args[all[i].at], all[i].must, all[i].to) < 0) return -1;
    memcpy(joints_d, h->q_hold, (size_t)n * sizeof(double));
    memset(joints_d + n, 0, (size_t)(2 * n) * sizeof(double));
    for (int i = 0; i < 3; i++)
        if (args[W_Q_D + i] != Py_None && take(args[W_Q_D + i], (looks){"q_d, v_d and q_dd", 1, {n}}, joints_d + i * n) < 0)
            return -1;
    memset(now->external, 0, sizeof now->external);
    if (args[W_EXTERNAL] != Py_None && take(args[W_EXTERNAL], (looks){"external", 1, {6}}, now->external) < 0) return -1;
    for (int j = 0; j < full; j++) {
        rates[j] = 0.0;
        for (int i = 0; i < n; i++) rates[j] += h->T[j * n + i] * v[i];
    }
    now->q = q, now->v = v, now->R_before = R_before, now->place = place;
    now->q_d = joints_d, now->v_d = joints_d + n, now->q_dd = joints_d + 2 * n;
    now->joints = (joint_motion){full, n, J, dJ, rates, h->T};
    return take_places(h, args[W_PLACES], place);
}

/* Lays out the block that `want` writes, which asks for it with PyBUF_WRITABLE; the others read it and ask with 0. Returns 0, or
 * -1 with an exception. */
static int hold_wanted(arrays *a, const hold_numbers *h, PyObject *object, int access, wanted *out)
{
    wanted nothing;
    double *block = hold_numbers_of(a, object, lay_out(h, NULL, &nothing), access);
    if (block == NULL) return -1;
    lay_out(h, block, out);
    return 0;
}

static PyObject *step_want(Step *self, PyObject *const *args, Py_ssize_t count)
{
    if (count != WANT_ARGUMENTS) {
        PyErr_SetString(PyExc_TypeError, "want takes eighteen arguments and answer");
        return NULL;
    }
    const hold_numbers *h = &self->hold;
    const size_t told_room = (size_t)(5 * h->n + 13 * h->full + 21 * h->N);
    arrays a = {.count = 0};
    told now;
    wanted out;
    int every_way = 0;
    double *room = PyMem_Malloc((told_room + want_room(h)) * sizeof(double));
    if (room == NULL) return PyErr_NoMemory();
    if (take_told(h, args, room, &now) == 0 && hold_wanted(&a, h, args[W_ANSWER], PyBUF_WRITABLE, &out) == 0)
        every_way = want(h, &now, room + told_room, &out);
    PyMem_Free(room);
    release(&a);
    if (PyErr_Occurred()) return NULL;
    return PyBool_FromLong(every_way);
}

/* ---- the margin --------------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(tighten_doc,
             "tighten(wanted, tau_u, shift, answer)\n--\n\n"
             "Writes w − G n s/μ (6,) and tau_u + Jᵀ n s/μ (n,) to `answer`, one after the other; `wanted` is what `want` wrote\n"
             "and shift (N,) is s/μ.");

static PyObject *step_tighten(Step *self, PyObject *const *args, Py_ssize_t count)
{
    if (count != 4) {
        PyErr_SetString(PyExc_TypeError, "tighten takes three arrays and answer");
        return NULL;
    }
    const hold_numbers *h = &self->hold;
    arrays a = {.count = 0};
    wanted out;
    const double *tau_u, *shift;
    double *answer;
    if (hold_wanted(&a, h, args[0], 0, &out) < 0) goto done;
    if ((tau_u = hold_block(&a, args[1], (looks){"tau_u", 1, {h->n}})) == NULL) goto done;
    if ((shift = hold_block(&a, args[2], (looks){"shift", 1, {h->N}})) == NULL) goto done;
    if ((answer = hold_answer(&a, args[3], 6 + h->n)) != NULL) tighten(h, &out, tau_u, shift, answer, answer + 6);
done:
    release(&a);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

/* ---- what comes of it --------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(settle_doc,
             "settle(wanted, q, tau_u, f, integral, creep, p_OF, R_OF, p_OC, grows, answer)\n--\n\n"
             "Writes the torques (n,), the creep (N, 2) and its size (N,), and the integral (6,) to `answer`, one after the other.\n"
             "Returns signs: 1 where a motor is at its limit, 2 where a tip slips or does not touch, 4 where a joint is at its end.\n"
             "creep is what the tips had slid, p_OF (N, 3), R_OF (N, 3, 3) and p_OC (N, 3) where they stood and touched, and grows\n"
             "whether the integral may.");

enum { S_WANTED, S_Q, S_TAU_U, S_F, S_INTEGRAL, S_CREEP, S_P_OF, S_R_OF, S_P_OC, S_GROWS, S_ANSWER, SETTLE_ARGUMENTS };

static PyObject *step_settle(Step *self, PyObject *const *args, Py_ssize_t count)
{
    if (count != SETTLE_ARGUMENTS) {
        PyErr_SetString(PyExc_TypeError, "settle takes ten arguments and answer");
        return NULL;
    }
    const hold_numbers *h = &self->hold;
    const int N = h->N, n = h->n;
    const looks must[] = {{"q", 1, {n}}, {"tau_u", 1, {n}}, {"f", 1, {h->k}}, {"integral", 1, {6}}, {"creep", 2, {N, 2}},
                          {"p_OF", 2, {N, 3}}, {"R_OF", 3, {N, 3, 3}}, {"p_OC", 2, {N, 3}}};
    const int sizes[] = {n, n, h->k, 6, 2 * N, 3 * N, 9 * N, 3 * N};
    arrays a = {.count = 0};
    wanted now;
    double *answer, *x[8], *room = PyMem_Malloc((size_t)(2 * n + h->k + 6 + 17 * N) * sizeof(double));
    int signs = 0;
    if (room == NULL) return PyErr_NoMemory();
    double *to = room;
    for (int i = 0; i < 8; to += sizes[i++])
        if (take(args[S_Q + i], must[i], x[i] = to) < 0) goto done;
    const int grows = PyObject_IsTrue(args[S_GROWS]);
    if (grows < 0 || hold_wanted(&a, h, args[S_WANTED], 0, &now) < 0) goto done;
    if ((answer = hold_answer(&a, args[S_ANSWER], n + 3 * N + 6)) == NULL) goto done;
    const before b = {x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], grows};
    signs = settle(h, &now, &b, &(after){answer, answer + n, answer + n + 2 * N, answer + n + 3 * N});
done:
    PyMem_Free(room);
    release(&a);
    if (PyErr_Occurred()) return NULL;
    return PyLong_FromLong(signs);
}

/* ---- the type ----------------------------------------------------------------------------------------------------------- */

static PyMethodDef step_methods[] = {
    {"want", (PyCFunction)(void (*)(void))step_want, METH_FASTCALL, want_doc},
    {"tighten", (PyCFunction)(void (*)(void))step_tighten, METH_FASTCALL, tighten_doc},
    {"settle", (PyCFunction)(void (*)(void))step_settle, METH_FASTCALL, settle_doc},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot step_slots[] = {
    {Py_tp_new, (void *)step_new}, {Py_tp_dealloc, (void *)step_free}, {Py_tp_methods, step_methods},
    {Py_tp_doc, (void *)step_doc}, {0, NULL},
};
static PyType_Spec step_spec = {"graspforce.control._laws.Step", sizeof(Step), 0, Py_TPFLAGS_DEFAULT, step_slots};

static int add_step(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&step_spec);
    if (type == NULL) return -1;
    const int added = PyModule_AddObjectRef(module, "Step", type);
    Py_DECREF(type);
    return added;
}

#endif
