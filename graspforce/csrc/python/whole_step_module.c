/* The Python module graspforce.core._whole_step with the type WholeStep: the whole step of the object controller (controller.h),
 * where its forces keep the slip margin of the settings.
 *
 * It makes no decisions: where no such forces are certified, it returns None, and the caller steps in Python. The memory between
 * two steps belongs to the caller, except for the start of the force solver. */
#include "../controller/controller.c"
#include "../controller/hand_model.c"
#include "control_step_object.inc"

static const char CONTROL_STEP_NAME[] = "graspforce.core._native.ControlStep";

typedef struct {
    PyObject_HEAD
    PyObject *step; /* the ControlStep that owns the grasp's numbers */
    gf_controller_setup setup;
    gf_hand_model hand;
    gf_link *links;
    double *numbers; /* arrays of hand and setup */
    int *components;
    gf_controller *controller;
} gf_py_whole_step;

PyDoc_STRVAR(
    whole_step_doc,
    "WholeStep(step, components, margin, force_weight, links, T, q0, rotor_inertia, torque_weight, tau_u_limits,\n"
    "          mu, gamma, normal_limits, /)\n--\n\n"
    "The whole step of the object controller where its forces keep the slip margin `margin`, N.\n\n"
    "`step` is the ControlStep of the grasp; `components` (N,) int32 are the force components of each contact. `links`\n"
    "(m, 30) has parent, is_prismatic, p_PL, R_PL, axis, mass, p_LM and inertia of gf_link. `mu`, `gamma` (N,) and\n"
    "`normal_limits` (2, N) are the limits with the friction reserve. The rest are fields of gf_hand_model and\n"
    "gf_controller_setup. Use an instance in one thread at a time.");

/* Numbers of a row of `links`: parent and kind, p_PL, R_PL, axis, mass, p_LM, inertia. */
enum { GF_LINK_NUMBERS = 2 + 3 + 9 + 3 + 1 + 3 + 9 };

/* Arrays of hand and setup, in the order of the arguments. */
#define GF_WHOLE_STEP_ARRAYS(FIELD)            \
    FIELD(links, joint_count, GF_LINK_NUMBERS) \
    FIELD(T, joint_count, motor_count)         \
    FIELD(q0, joint_count)                     \
    FIELD(rotor_inertia, motor_count)          \
    FIELD(torque_weight, motor_count)          \
    FIELD(tau_u_limits, 2, motor_count)        \
    FIELD(mu, contact_count)                   \
    FIELD(gamma, contact_count)                \
    FIELD(normal_limits, 2, contact_count)

enum {
#define GF_INDEX(name, ...) GF_WHOLE_##name,
    GF_WHOLE_STEP_ARRAYS(GF_INDEX) GF_WHOLE_ARRAYS
#undef GF_INDEX
};

/* Inputs of a step. The last four may be None, and in the first step p_OF, R_OF and p_OC, too. */
#define GF_WHOLE_STEP_INPUTS(FIELD)  \
    FIELD(q, motor_count)            \
    FIELD(v, motor_count)            \
    FIELD(p_HO, 3)                   \
    FIELD(R_HO, 3, 3)                \
    FIELD(twist, 6)                  \
    FIELD(p_d, 3)                    \
    FIELD(R_d, 3, 3)                 \
    FIELD(twist_d, 6)                \
    FIELD(acceleration_d, 6)         \
    FIELD(integral, 6)               \
    FIELD(R_OC, contact_count, 3, 3) \
    FIELD(creep, contact_count, 2)   \
    FIELD(p_OF, contact_count, 3)    \
    FIELD(R_OF, contact_count, 3, 3) \
    FIELD(p_OC, contact_count, 3)    \
    FIELD(q_d, motor_count)          \
    FIELD(v_d, motor_count)          \
    FIELD(a_d, motor_count)          \
    FIELD(external, 6)

enum {
#define GF_INDEX(name, ...) GF_IN_##name,
    GF_WHOLE_STEP_INPUTS(GF_INDEX) GF_WHOLE_INPUTS,
#undef GF_INDEX
    GF_OUT_targets = GF_WHOLE_INPUTS,
    GF_OUT_forces,
    GF_OUT_result,
    GF_WHOLE_ARGUMENTS
};

/* Outputs of the force problem.
 *
 * own           torques of the hand's own motion, N·m
 * tau_u         the same within their limits, N·m
 * f             contact forces in the contact frames, N and N·m
 * y …           multipliers of the problem that is shifted by the slip margin, see gf_solution
 * tau           torques of that problem, N·m
 * residuals     of its certificate: primal, dual, gap */
#define GF_FORCE_FIELDS(FIELD)       \
    FIELD(own, motor_count)          \
    FIELD(tau_u, motor_count)        \
    FIELD(f, force_size)             \
    FIELD(y, 6)                      \
    FIELD(nu_lower, contact_count)   \
    FIELD(nu_upper, contact_count)   \
    FIELD(lambda_lower, motor_count) \
    FIELD(lambda_upper, motor_count) \
    FIELD(tau, motor_count)          \
    FIELD(residuals, 3)

/* ---- construction --------------------------------------------------------------------------------------------------------- */

/* Read a link from its numbers. Return whether its parent stands before it. */
static int gf_read_link(const double *x, int index, gf_link *link)
{
    link->parent = (int)x[0], link->is_prismatic = x[1] != 0.0, x += 2;
    memcpy(link->p_PL, x, sizeof link->p_PL), x += 3;
    memcpy(link->R_PL, x, sizeof link->R_PL), x += 9;
    memcpy(link->axis, x, sizeof link->axis), x += 3;
    link->mass = *x++;
    memcpy(link->p_LM, x, sizeof link->p_LM), x += 3;
    memcpy(link->inertia, x, sizeof link->inertia);
    return link->parent >= -1 && link->parent < index;
}

/* Copy the arrays of hand and setup. Return 0, or -1 with an exception. */
static int gf_copy_setup(gf_py_whole_step *self, PyObject *const *values)
{
    const gf_controlled_grasp *grasp = &self->setup.grasp;
    GF_DEFINE_SHAPES(grasp);
    const gf_array_spec specs[] = {GF_WHOLE_STEP_ARRAYS(GF_SPEC)};
    const double *fields[GF_WHOLE_ARRAYS];
    Py_ssize_t size = 1;
    for (int i = 0; i < GF_WHOLE_ARRAYS; i++) size += gf_spec_size(&specs[i]);
    double *to = self->numbers = PyMem_Calloc((size_t)size, sizeof(double));
    self->links = PyMem_Calloc((size_t)joint_count + 1, sizeof(gf_link));
    if (to == NULL || self->links == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    for (int i = 0; i < GF_WHOLE_ARRAYS; i++) {
        if (gf_copy_array(values[i], specs[i], to) < 0) return -1;
        fields[i] = to;
        to += gf_spec_size(&specs[i]);
    }
    for (int l = 0; l < grasp->joint_count; l++)
        if (!gf_read_link(fields[GF_WHOLE_links] + GF_LINK_NUMBERS * l, l, self->links + l)) {
            PyErr_SetString(PyExc_ValueError, "links must follow their parents");
            return -1;
        }
    self->hand = (gf_hand_model){.motor_count = grasp->motor_count,
                                 .joint_count = grasp->joint_count,
                                 .links = self->links,
                                 .T = fields[GF_WHOLE_T],
                                 .q0 = fields[GF_WHOLE_q0],
                                 .rotor_inertia = fields[GF_WHOLE_rotor_inertia],
                                 .torque_limits = grasp->torque_limits,
                                 .torque_weight = fields[GF_WHOLE_torque_weight]};
    gf_controller_setup *setup = &self->setup;
    const double *normal_limits = fields[GF_WHOLE_normal_limits];
    setup->hand = &self->hand, setup->components = self->components, setup->tau_u_limits = fields[GF_WHOLE_tau_u_limits];
    setup->nominal = (gf_contact_limits){.mu = fields[GF_WHOLE_mu],
                                         .gamma = fields[GF_WHOLE_gamma],
                                         .min_normal = normal_limits,
                                         .max_normal = normal_limits + contact_count};
    setup->bare = setup->nominal;
    return 0;
}

/* Copy the number of force components of each contact. Return 0, or -1 with an exception. */
static int gf_copy_components(gf_py_whole_step *self, PyObject *value)
{
    Py_buffer view;
    const int N = self->setup.grasp.contact_count;
    if (PyObject_GetBuffer(value, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return -1;
    const int fits = view.format != NULL && strcmp(view.format, "i") == 0 && view.len == N * (Py_ssize_t)sizeof(int);
    self->components = PyMem_Calloc((size_t)N + 1, sizeof(int));
    if (fits && self->components != NULL) memcpy(self->components, view.buf, (size_t)view.len);
    PyBuffer_Release(&view);
    if (self->components == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    if (fits) return 0;
    PyErr_Format(PyExc_ValueError, "components must be an array of type 'i' and shape (%d,)", N);
    return -1;
}

static PyObject *gf_py_whole_step_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    PyObject *step, *components, *values[GF_WHOLE_ARRAYS];
    double margin, force_weight;
    if (keywords != NULL && PyDict_Size(keywords) > 0) {
        PyErr_SetString(PyExc_TypeError, "WholeStep() takes positional arguments only");
        return NULL;
    }
    if (!PyArg_ParseTuple(args, "OOddOOOOOOOOO;WholeStep() takes 13 arguments", &step, &components, &margin, &force_weight,
                          &values[0], &values[1], &values[2], &values[3], &values[4], &values[5], &values[6], &values[7],
                          &values[8]))
        return NULL;
    if (strcmp(Py_TYPE(step)->tp_name, CONTROL_STEP_NAME) != 0) {
        PyErr_SetString(PyExc_TypeError, "step must be a ControlStep");
        return NULL;
    }
    gf_py_whole_step *self = (gf_py_whole_step *)type->tp_alloc(type, 0);
    if (self == NULL) return NULL;
    self->step = Py_NewRef(step);
    const gf_py_control_step *own = (gf_py_control_step *)step;
    self->setup =
        (gf_controller_setup){.grasp = own->grasp, .tip_links = own->tip_links, .margin = margin, .force_weight = force_weight};
    if (gf_copy_components(self, components) == 0 && gf_copy_setup(self, values) == 0) {
        const size_t size = gf_controller_size(&self->setup);
        void *memory = size == 0 ? NULL : PyMem_Malloc(size);
        if (size != 0 && memory == NULL) PyErr_NoMemory();
        self->controller = gf_controller_init(&self->setup, memory, size);
        if (self->controller != NULL) return (PyObject *)self;
        PyMem_Free(memory);
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "the sizes of grasp and hand do not fit together");
    }
    Py_DECREF(self);
    return NULL;
}

static void gf_py_whole_step_free(gf_py_whole_step *self)
{
    PyTypeObject *type = Py_TYPE(self);
    PyMem_Free(self->numbers);
    PyMem_Free(self->links);
    PyMem_Free(self->components);
    PyMem_Free(self->controller);
    Py_XDECREF(self->step);
    type->tp_free((PyObject *)self);
    Py_DECREF(type);
}

/* ---- step ----------------------------------------------------------------------------------------------------------------- */

/* Copy the inputs of a step to `numbers`. Return 0, or -1 with an exception. */
static int gf_copy_whole_inputs(const gf_array_spec *specs, PyObject *const *values, double *numbers, const double **fields)
{
    for (int i = 0; i < GF_WHOLE_INPUTS; i++) {
        fields[i] = NULL;
        if (i >= GF_IN_p_OF && values[i] == Py_None) continue;
        if (gf_copy_array(values[i], specs[i], numbers) < 0) return -1;
        fields[i] = numbers;
        numbers += gf_spec_size(&specs[i]);
    }
    return 0;
}

/* Copy the numbers of the force problem to their block. */
static void gf_write_forces(const gf_controller *c, const double *own, double *to)
{
    const gf_controlled_grasp *g = &c->setup->grasp;
    const gf_step_problem *p = &c->problem;
    const size_t N = (size_t)g->contact_count, n = (size_t)g->motor_count, k = (size_t)g->force_size;
    const double residuals[3] = {p->residuals.primal, p->residuals.dual, p->residuals.gap};
    const double *const parts[] = {own,    c->tau_u, p->f, p->y, p->nu_lower, p->nu_upper, p->lambda_lower, p->lambda_upper,
                                   p->tau, residuals};
    const size_t sizes[] = {n, n, k, 6, N, N, n, n, n, 3};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        memcpy(to, parts[i], sizes[i] * sizeof(double));
        to += sizes[i];
    }
}

/* Compute a step. Return its flags, or -1 if no forces with the full slip margin are certified. */
static int gf_take_whole_step(gf_controller *c, const double *const *in, double *own, int *iterations, gf_step_result *result)
{
    const gf_controller_setup *setup = c->setup;
    const gf_control_inputs inputs = {.q = in[GF_IN_q],
                                      .v = in[GF_IN_v],
                                      .p_HO = in[GF_IN_p_HO],
                                      .R_HO = in[GF_IN_R_HO],
                                      .twist = in[GF_IN_twist],
                                      .p_d = in[GF_IN_p_d],
                                      .R_d = in[GF_IN_R_d],
                                      .twist_d = in[GF_IN_twist_d],
                                      .acceleration_d = in[GF_IN_acceleration_d],
                                      .q_d = in[GF_IN_q_d],
                                      .v_d = in[GF_IN_v_d],
                                      .a_d = in[GF_IN_a_d],
                                      .external = in[GF_IN_external]};
    gf_step_memory *before = &c->memory[0];
    memcpy(before->integral, in[GF_IN_integral], 6 * sizeof(double));
    memcpy(before->R_OC, in[GF_IN_R_OC], 9 * (size_t)setup->grasp.contact_count * sizeof(double));
    if (!gf_step_to_targets(c, &inputs, before)) return -1;
    gf_own_torques(c);
    memcpy(own, c->tau_u, (size_t)setup->grasp.motor_count * sizeof(double));
    gf_limit_free_torques(c);
    if (!gf_solve_margin(setup, &setup->nominal, setup->margin, &c->targets, c->tau_u, &c->problem, iterations)) return -1;
    const gf_contacts *now = &c->targets.contacts;
    const int is_first = in[GF_IN_p_OF] == NULL || in[GF_IN_R_OF] == NULL || in[GF_IN_p_OC] == NULL;
    const gf_result_inputs after = {.q = in[GF_IN_q],
                                    .tau_u = c->tau_u,
                                    .f = c->problem.f,
                                    .integral = in[GF_IN_integral],
                                    .creep = in[GF_IN_creep],
                                    .p_OF = is_first ? now->p_OF : in[GF_IN_p_OF],
                                    .R_OF = is_first ? now->R_OF : in[GF_IN_R_OF],
                                    .p_OC = is_first ? now->p_OC : in[GF_IN_p_OC],
                                    .integral_rule = GF_INTEGRAL_UNLESS_SATURATED};
    const int flags = gf_compute_result(&setup->grasp, &c->targets, &after, result);
    if (is_first) gf_first_creep(c, &inputs, result);
    return flags;
}

PyDoc_STRVAR(
    whole_step_step_doc,
    "step(q, v, p_HO, R_HO, twist, p_d, R_d, twist_d, acceleration_d, integral, R_OC, creep, p_OF, R_OF, p_OC,\n"
    "     q_d, v_d, a_d, external, targets, forces, result, /)\n--\n\n"
    "Write targets, forces and result of a step to blocks, and return its flags and the iterations of the solver.\n\n"
    "Return None, with undefined blocks, if no forces with the full slip margin are certified. The inputs are fields\n"
    "of gf_control_inputs, and of the memory after the last step. In the first step p_OF, R_OF and p_OC are None; q_d,\n"
    "v_d, a_d and external may be None. The blocks have the layouts `ControlStep.targets_layout`, `forces_layout` and\n"
    "`ControlStep.result_layout`.");

static PyObject *gf_py_whole_step_step(gf_py_whole_step *self, PyObject *const *args, Py_ssize_t count)
{
    const gf_controlled_grasp *grasp = &self->setup.grasp;
    GF_DEFINE_SHAPES(grasp);
    const gf_array_spec specs[] = {GF_WHOLE_STEP_INPUTS(GF_SPEC)}, outputs[] = {GF_FORCE_FIELDS(GF_SPEC)};
    gf_array_views held = {.count = 0};
    const double *in[GF_WHOLE_INPUTS];
    double *targets, *forces, *block;
    Py_ssize_t size = motor_count, forces_size = 0;
    int flags = -1, iterations = 0;
    if (count != GF_WHOLE_ARGUMENTS) return PyErr_Format(PyExc_TypeError, "step() takes %d arguments", GF_WHOLE_ARGUMENTS);
    for (int i = 0; i < GF_WHOLE_INPUTS; i++) size += gf_spec_size(&specs[i]);
    for (size_t i = 0; i < sizeof outputs / sizeof *outputs; i++) forces_size += gf_spec_size(&outputs[i]);
    double *numbers = PyMem_Malloc((size_t)size * sizeof(double)), *own = numbers;
    if (numbers == NULL) return PyErr_NoMemory();
    if (gf_copy_whole_inputs(specs, args, numbers + motor_count, in) < 0) goto done;
    const Py_ssize_t targets_size = (Py_ssize_t)gf_targets_size(grasp), result_size = (Py_ssize_t)gf_result_size(grasp);
    if ((targets = gf_view_block(&held, args[GF_OUT_targets], "targets", targets_size, PyBUF_WRITABLE)) == NULL) goto done;
    if ((forces = gf_view_block(&held, args[GF_OUT_forces], "forces", forces_size, PyBUF_WRITABLE)) == NULL) goto done;
    if ((block = gf_view_block(&held, args[GF_OUT_result], "result", result_size, PyBUF_WRITABLE)) == NULL) goto done;
    gf_controller *c = self->controller;
    gf_step_result result = gf_map_result(grasp, block);
    flags = gf_take_whole_step(c, in, own, &iterations, &result);
    if (flags >= 0) {
        memcpy(targets, c->targets.error, (size_t)targets_size * sizeof(double)); /* the first field of their block */
        gf_write_forces(c, own, forces);
    }
done:
    PyMem_Free(numbers);
    gf_release_views(&held);
    if (PyErr_Occurred()) return NULL;
    if (flags < 0) Py_RETURN_NONE;
    return Py_BuildValue("ii", flags, iterations);
}

static PyObject *gf_py_forces_layout(gf_py_whole_step *self, void *closure)
{
    (void)closure;
    GF_DEFINE_SHAPES(&self->setup.grasp);
    const gf_array_spec specs[] = {GF_FORCE_FIELDS(GF_SPEC)};
    return gf_describe_layout(specs, (int)(sizeof specs / sizeof *specs));
}

static PyMethodDef whole_step_methods[] = {
    {"step", (PyCFunction)(void (*)(void))gf_py_whole_step_step, METH_FASTCALL, whole_step_step_doc},
    {NULL, NULL, 0, NULL},
};
static PyGetSetDef whole_step_getters[] = {
    {"forces_layout", (getter)gf_py_forces_layout, NULL, "Layout of the forces, for numpy.dtype.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};
static PyType_Slot whole_step_slots[] = {
    {Py_tp_new, (void *)gf_py_whole_step_new}, {Py_tp_dealloc, (void *)gf_py_whole_step_free},
    {Py_tp_methods, whole_step_methods},       {Py_tp_getset, whole_step_getters},
    {Py_tp_doc, (void *)whole_step_doc},       {0, NULL},
};
static PyType_Spec whole_step_spec = {"graspforce.core._whole_step.WholeStep", sizeof(gf_py_whole_step), 0, Py_TPFLAGS_DEFAULT,
                                      whole_step_slots};

/* Add the type to the module. Return 0, or -1 with an exception. */
static int gf_py_add_whole_step(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&whole_step_spec);
    if (type == NULL) return -1;
    const int added = PyModule_AddObjectRef(module, "WholeStep", type);
    Py_DECREF(type);
    return added;
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)gf_py_add_whole_step}, {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_whole_step", .m_size = 0, .m_slots = slots};

PyMODINIT_FUNC PyInit__whole_step(void)
{
    return PyModuleDef_Init(&definition);
}
