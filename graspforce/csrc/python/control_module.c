/* The Python module graspforce.core._native: contact kinematics, contact poses and their fusion with measured poses,
 * contact forces, slip, precautions, friction, payload, a filter of joints, motions of bodies, joint accelerations, joint friction, messages of control
 * streams and their authentication, and the types ControlStep and MessageCode.
 *
 * Functions take keyword arguments: float64 arrays, and the arrays that they write. Those of control streams, which must be quickest,
 * take positional ones. The module keeps no state. */
#include "body_motion_function.inc"
#include "contact_forces_function.inc"
#include "contact_pose_function.inc"
#include "friction_bounds_function.inc"
#include "friction_function.inc"
#include "joint_filter_function.inc"
#include "message_code_type.inc"
#include "payload_function.inc"
#include "pose_fusion_function.inc"
#include "precaution_function.inc"
#include "slip_function.inc"
#include "stream_check_functions.inc"
#include "stream_command_function.inc"
#include "stream_command_reader.inc"
#include "stream_state_function.inc"
#include "stream_state_writer.inc"

/* Copy row i of an array. */
static void gf_read_vector(const Py_buffer *view, Py_ssize_t i, gf_vector3 x)
{
    for (int k = 0; k < 3; k++) x[k] = gf_array_item(view, i, k, 0);
}

/* Copy matrix i of an array. */
static void gf_read_matrix(const Py_buffer *view, Py_ssize_t i, gf_matrix3 R)
{
    for (int k = 0; k < 9; k++) R[k] = gf_array_item(view, i, k / 3, k % 3);
}

/* ---- contacts ------------------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(contacts_layout_doc, "contacts_layout(contact_count, motor_count)\n--\n\n"
                                  "Return the layout of the contacts that compute_contacts() writes, for numpy.dtype.");

static PyObject *gf_py_contacts_layout(PyObject *module, PyObject *args)
{
    Py_ssize_t contact_count, motor_count;
    (void)module;
    if (!PyArg_ParseTuple(args, "nn", &contact_count, &motor_count)) return NULL;
    const gf_array_spec specs[] = {GF_CONTACT_FIELDS(GF_CONTACT_SPEC)};
    return gf_describe_layout(specs, (int)(sizeof specs / sizeof *specs));
}

PyDoc_STRVAR(
    compute_contacts_doc,
    "compute_contacts(*, surface, p_HF, R_HF, rates, radii, p_HO, R_HO, twist, p_OC, R_OC, R_OC_last, contacts)\n--\n\n"
    "Write the N contacts of fingertips on an object to `contacts`, an array of the dtype `contacts_layout(N, n)`.\n\n"
    "`surface` is Shape.primitive_parameters; `rates` (N, 6, n + 2) is contiguous and holds Jacobian, twist and drift;\n"
    "`p_OC` and `R_OC` are the contacts at the start of the grasp, `R_OC_last` the frames at the last step.");

enum { IN_P_HF, IN_R_HF, IN_RATES, IN_RADII, IN_P_HO, IN_R_HO, IN_TWIST, IN_P_OC, IN_R_OC, IN_R_OC_LAST, TIP_ARRAYS };

/* View the arrays that describe tips and object. Return the number of motors, or -1 with an exception. */
static Py_ssize_t gf_view_tips(gf_array_views *held, PyObject *const *values)
{
    const gf_array_spec first = {"p_HF", 2, {GF_ANY_SIZE, 3}};
    if (gf_view_array(held, values[IN_P_HF], first) < 0) return -1;
    const Py_ssize_t N = held->views[0].shape[0];
    const gf_array_spec specs[] = {
        [IN_R_HF] = {"R_HF", 3, {N, 3, 3}},
        [IN_RATES] = {"rates", 3, {N, 6, GF_ANY_SIZE}},
        [IN_RADII] = {"radii", 1, {N}},
        [IN_P_HO] = {"p_HO", 1, {3}},
        [IN_R_HO] = {"R_HO", 2, {3, 3}},
        [IN_TWIST] = {"twist", 1, {6}},
        [IN_P_OC] = {"p_OC", 2, {N, 3}},
        [IN_R_OC] = {"R_OC", 3, {N, 3, 3}},
        [IN_R_OC_LAST] = {"R_OC_last", 3, {N, 3, 3}},
    };
    for (int i = IN_R_HF; i <= IN_R_OC_LAST; i++)
        if (i == IN_RATES ? gf_view_contiguous(held, values[i], specs[i]) == NULL
                          : gf_view_array(held, values[i], specs[i]) < 0)
            return -1;
    const Py_ssize_t width = held->views[IN_RATES].shape[2];
    if (width >= 2) return width - 2;
    PyErr_SetString(PyExc_ValueError, "rates must hold Jacobian, twist and drift");
    return -1;
}

/* Compute all contacts and write them to a block. */
static void gf_compute_all_contacts(const gf_array_views *held, const gf_surface *surface, Py_ssize_t motor_count,
                                    double *block)
{
    const Py_buffer *views = held->views;
    const Py_ssize_t contact_count = views[IN_P_HF].shape[0];
    gf_object_state object = {.surface = *surface};
    const gf_array_spec specs[] = {GF_CONTACT_FIELDS(GF_CONTACT_SPEC)};
    gf_contacts contacts;
    double **fields[] = {
#define GF_ADDRESS(name, ...) &contacts.name,
        GF_CONTACT_FIELDS(GF_ADDRESS)
#undef GF_ADDRESS
    };
    for (size_t i = 0; i < sizeof specs / sizeof *specs; block += gf_spec_size(&specs[i++])) *fields[i] = block;
    for (int k = 0; k < 3; k++) object.p_HO[k] = gf_array_item(&views[IN_P_HO], k, 0, 0);
    for (int k = 0; k < 9; k++) object.R_HO[k] = gf_array_item(&views[IN_R_HO], k / 3, k % 3, 0);
    for (int k = 0; k < 6; k++) object.twist[k] = gf_array_item(&views[IN_TWIST], k, 0, 0);
    for (Py_ssize_t i = 0; i < contact_count; i++) {
        const double *rates = (const double *)views[IN_RATES].buf + 6 * (motor_count + 2) * i;
        gf_fingertip tip = {.motor_count = (int)motor_count,
                            .radius = gf_array_item(&views[IN_RADII], i, 0, 0),
                            .rates = rates};
        gf_read_vector(&views[IN_P_HF], i, tip.p_HF);
        gf_read_matrix(&views[IN_R_HF], i, tip.R_HF);
        gf_read_vector(&views[IN_P_OC], i, tip.p_OC_start);
        gf_read_matrix(&views[IN_R_OC], i, tip.R_OC_start);
        gf_read_matrix(&views[IN_R_OC_LAST], i, tip.R_OC_last);
        const gf_contacts contact = gf_contact_at(&contacts, (int)i, (int)motor_count);
        gf_compute_contact(&object, &tip, &contact);
    }
}

static PyObject *gf_py_compute_contacts(PyObject *module, PyObject *const *args, Py_ssize_t count, PyObject *keywords)
{
    static const char *const names[] = {"surface", "p_HF",  "R_HF", "rates", "radii",     "p_HO",
                                        "R_HO",    "twist", "p_OC", "R_OC",  "R_OC_last", "contacts"};
    PyObject *values[TIP_ARRAYS + 2];
    gf_surface surface;
    (void)module;
    if (gf_sort_arguments("compute_contacts", names, TIP_ARRAYS + 2, args, count, keywords, values) < 0) return NULL;
    if (gf_read_surface(values[0], &surface) < 0) return NULL;
    gf_array_views held = {.count = 0};
    const Py_ssize_t motor_count = gf_view_tips(&held, values + 1);
    if (motor_count >= 0) {
        const Py_ssize_t contact_count = held.views[0].shape[0];
        const gf_array_spec specs[] = {GF_CONTACT_FIELDS(GF_CONTACT_SPEC)};
        Py_ssize_t size = 0;
        for (size_t i = 0; i < sizeof specs / sizeof *specs; i++) size += gf_spec_size(&specs[i]);
        double *block = gf_view_block(&held, values[TIP_ARRAYS + 1], "contacts", size, PyBUF_WRITABLE);
        if (block != NULL) gf_compute_all_contacts(&held, &surface, motor_count, block);
    }
    gf_release_views(&held);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

/* ---- sliding -------------------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(slip_displacement_doc,
             "slip_displacement(*, p_OF_last, R_OF_last, p_OC_last, p_OF, R_OF, R_OC, slip)\n--\n\n"
             "Write the sliding of N fingertips between two instants along t1 and t2 to `slip` (N, 2), m.");

enum { SLIP_INPUTS = 6 };

static PyObject *gf_py_slip_displacement(PyObject *module, PyObject *const *args, Py_ssize_t count, PyObject *keywords)
{
    static const char *const names[] = {"p_OF_last", "R_OF_last", "p_OC_last", "p_OF", "R_OF", "R_OC", "slip"};
    static const int dimensions[SLIP_INPUTS] = {2, 3, 2, 2, 3, 3};
    PyObject *values[SLIP_INPUTS + 1];
    (void)module;
    if (gf_sort_arguments("slip_displacement", names, SLIP_INPUTS + 1, args, count, keywords, values) < 0) return NULL;
    gf_array_views held = {.count = 0};
    const Py_buffer *views = held.views;
    Py_ssize_t N = GF_ANY_SIZE;
    for (int i = 0; i < SLIP_INPUTS; i++) {
        if (gf_view_array(&held, values[i], (gf_array_spec){names[i], dimensions[i], {N, 3, 3}}) < 0) goto done;
        N = views[0].shape[0];
    }
    double *slip = gf_view_block(&held, values[SLIP_INPUTS], "slip", 2 * N, PyBUF_WRITABLE);
    for (Py_ssize_t i = 0; slip != NULL && i < N; i++) {
        gf_vector3 p_OF_last, p_OC_last, p_OF;
        gf_matrix3 R_OF_last, R_OF, R_OC;
        gf_read_vector(&views[0], i, p_OF_last);
        gf_read_matrix(&views[1], i, R_OF_last);
        gf_read_vector(&views[2], i, p_OC_last);
        gf_read_vector(&views[3], i, p_OF);
        gf_read_matrix(&views[4], i, R_OF);
        gf_read_matrix(&views[5], i, R_OC);
        const gf_tip_contact last = {.p_OF = p_OF_last, .R_OF = R_OF_last, .p_OC = p_OC_last};
        gf_slip_displacement(&last, p_OF, R_OF, R_OC, slip + 2 * i);
    }
done:
    gf_release_views(&held);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

/* ---- joint accelerations -------------------------------------------------------------------------------------------------- */

PyDoc_STRVAR(joint_accelerations_doc,
             "joint_accelerations(*, A, B, beta, object_acceleration, posture, rank_tolerance, joint_acceleration)\n--\n\n"
             "Write the joint accelerations that keep the contacts to `joint_acceleration` (n,), rad/s².\n\n"
             "Return False if A (r, n) may lack full row rank; the output then is undefined. B (r, 6), beta (r,),\n"
             "object_acceleration (6,) and posture (n,) are contiguous, as is A.");

enum { IN_A, IN_B, IN_BETA, IN_OBJECT_ACCELERATION, IN_POSTURE, IN_RANK_TOLERANCE, OUT_JOINT_ACCELERATION, JOINT_ARGUMENTS };

static PyObject *gf_py_joint_accelerations(PyObject *module, PyObject *const *args, Py_ssize_t count, PyObject *keywords)
{
    static const char *const names[] = {
        "A", "B", "beta", "object_acceleration", "posture", "rank_tolerance", "joint_acceleration"};
    PyObject *values[JOINT_ARGUMENTS];
    (void)module;
    if (gf_sort_arguments("joint_accelerations", names, JOINT_ARGUMENTS, args, count, keywords, values) < 0) return NULL;
    const double rank_tolerance = PyFloat_AsDouble(values[IN_RANK_TOLERANCE]), *inputs[IN_RANK_TOLERANCE];
    if (PyErr_Occurred()) return NULL;
    gf_array_views held = {.count = 0};
    double *work = NULL, *joint_acceleration;
    int has_full_rank = 0;
    if ((inputs[IN_A] = gf_view_contiguous(&held, values[IN_A], (gf_array_spec){"A", 2, {GF_ANY_SIZE, GF_ANY_SIZE}})) == NULL)
        goto done;
    const Py_ssize_t r = held.views[IN_A].shape[0], n = held.views[IN_A].shape[1];
    const gf_array_spec specs[] = {
        [IN_B] = {"B", 2, {r, 6}},
        [IN_BETA] = {"beta", 1, {r}},
        [IN_OBJECT_ACCELERATION] = {"object_acceleration", 1, {6}},
        [IN_POSTURE] = {"posture", 1, {n}},
    };
    for (int i = IN_B; i <= IN_POSTURE; i++)
        if ((inputs[i] = gf_view_contiguous(&held, values[i], specs[i])) == NULL) goto done;
    joint_acceleration = gf_view_block(&held, values[OUT_JOINT_ACCELERATION], names[OUT_JOINT_ACCELERATION], n, PyBUF_WRITABLE);
    if (joint_acceleration == NULL) goto done;
    if ((work = PyMem_Malloc((size_t)(r * (r + 7)) * sizeof(double))) == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    const gf_constraints constraints = {(int)r, (int)n, .A = inputs[IN_A], .B = inputs[IN_B], .beta = inputs[IN_BETA]};
    double acceleration[6]; /* without compliance it stays as it is */
    memcpy(acceleration, inputs[IN_OBJECT_ACCELERATION], sizeof acceleration);
    has_full_rank = gf_joint_accelerations(&constraints, acceleration, inputs[IN_POSTURE], rank_tolerance, work,
                                           joint_acceleration);
done:
    PyMem_Free(work);
    gf_release_views(&held);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(has_full_rank);
}

/* ---- module --------------------------------------------------------------------------------------------------------------- */

static PyMethodDef functions[] = {
    {"contacts_layout", gf_py_contacts_layout, METH_VARARGS, contacts_layout_doc},
    {"compute_contacts", (PyCFunction)(void (*)(void))gf_py_compute_contacts, METH_FASTCALL | METH_KEYWORDS,
     compute_contacts_doc},
    {"slip_displacement", (PyCFunction)(void (*)(void))gf_py_slip_displacement, METH_FASTCALL | METH_KEYWORDS,
     slip_displacement_doc},
    {"joint_accelerations", (PyCFunction)(void (*)(void))gf_py_joint_accelerations, METH_FASTCALL | METH_KEYWORDS,
     joint_accelerations_doc},
    {"tracked_grasp_layout", gf_py_tracked_grasp_layout, METH_VARARGS, tracked_grasp_layout_doc},
    {"contact_pose_layout", gf_py_contact_pose_layout, METH_VARARGS, contact_pose_layout_doc},
    {"track_contacts", (PyCFunction)(void (*)(void))gf_py_track_contacts, METH_FASTCALL | METH_KEYWORDS, track_contacts_doc},
    {"pose_uncertainty", (PyCFunction)(void (*)(void))gf_py_pose_uncertainty, METH_FASTCALL | METH_KEYWORDS,
     pose_uncertainty_doc},
    {"force_model_layout", gf_py_force_model_layout, METH_VARARGS, force_model_layout_doc},
    {"force_gains_layout", gf_py_force_gains_layout, METH_VARARGS, force_gains_layout_doc},
    {"contact_forces_layout", gf_py_contact_forces_layout, METH_VARARGS, contact_forces_layout_doc},
    {"force_gains", (PyCFunction)(void (*)(void))gf_py_force_gains, METH_FASTCALL | METH_KEYWORDS, force_gains_doc},
    {"contact_forces", (PyCFunction)(void (*)(void))gf_py_contact_forces, METH_FASTCALL | METH_KEYWORDS, contact_forces_doc},
    {"slip_settings_layout", gf_py_slip_settings_layout, METH_VARARGS, slip_settings_layout_doc},
    {"slip_test_layout", gf_py_slip_test_layout, METH_VARARGS, slip_test_layout_doc},
    {"slip_state_layout", gf_py_slip_state_layout, METH_VARARGS, slip_state_layout_doc},
    {"slip_step", (PyCFunction)(void (*)(void))gf_py_slip_step, METH_FASTCALL | METH_KEYWORDS, slip_step_doc},
    {"precaution_settings_layout", gf_py_precaution_settings_layout, METH_NOARGS, precaution_settings_layout_doc},
    {"precaution_state_layout", gf_py_precaution_state_layout, METH_VARARGS, precaution_state_layout_doc},
    {"precaution_step", (PyCFunction)(void (*)(void))gf_py_precaution_step, METH_FASTCALL | METH_KEYWORDS, precaution_step_doc},
    {"payload_settings_layout", gf_py_payload_settings_layout, METH_NOARGS, payload_settings_layout_doc},
    {"payload_inputs_layout", gf_py_payload_inputs_layout, METH_NOARGS, payload_inputs_layout_doc},
    {"payload_state_layout", gf_py_payload_state_layout, METH_NOARGS, payload_state_layout_doc},
    {"payload_inputs", (PyCFunction)(void (*)(void))gf_py_payload_inputs, METH_FASTCALL | METH_KEYWORDS, payload_inputs_doc},
    {"payload_step", (PyCFunction)(void (*)(void))gf_py_payload_step, METH_FASTCALL | METH_KEYWORDS, payload_step_doc},
    {"bound_settings_layout", gf_py_bound_settings_layout, METH_VARARGS, bound_settings_layout_doc},
    {"bound_state_layout", gf_py_bound_state_layout, METH_VARARGS, bound_state_layout_doc},
    {"friction_bounds_step", (PyCFunction)(void (*)(void))gf_py_friction_bounds_step, METH_FASTCALL | METH_KEYWORDS,
     friction_bounds_step_doc},
    {"body_motion_layout", gf_py_body_motion_layout, METH_NOARGS, body_motion_layout_doc},
    {"fixed_frame_motion", (PyCFunction)(void (*)(void))gf_py_fixed_frame_motion, METH_FASTCALL | METH_KEYWORDS,
     fixed_frame_motion_doc},
    {"parent_frame_motion", (PyCFunction)(void (*)(void))gf_py_parent_frame_motion, METH_FASTCALL | METH_KEYWORDS,
     parent_frame_motion_doc},
    {"motion_after", (PyCFunction)(void (*)(void))gf_py_motion_after, METH_FASTCALL | METH_KEYWORDS, motion_after_doc},
    {"filter_joints", (PyCFunction)(void (*)(void))gf_py_filter_joints, METH_FASTCALL | METH_KEYWORDS, filter_joints_doc},
    {"offset_layout", gf_py_offset_layout, METH_NOARGS, offset_layout_doc},
    {"fuse_pose", (PyCFunction)(void (*)(void))gf_py_fuse_pose, METH_FASTCALL | METH_KEYWORDS, fuse_pose_doc},
    {"interpolate_pose", (PyCFunction)(void (*)(void))gf_py_interpolate_pose, METH_FASTCALL | METH_KEYWORDS,
     interpolate_pose_doc},
    {"friction_layout", gf_py_friction_layout, METH_VARARGS, friction_layout_doc},
    {"friction_result_layout", gf_py_friction_result_layout, METH_VARARGS, friction_result_layout_doc},
    {"friction_step", (PyCFunction)(void (*)(void))gf_py_friction_step, METH_FASTCALL | METH_KEYWORDS, friction_step_doc},
    {"read_stream_state", (PyCFunction)(void (*)(void))gf_py_read_stream_state, METH_FASTCALL, read_stream_state_doc},
    {"join_stream_state", (PyCFunction)(void (*)(void))gf_py_join_stream_state, METH_FASTCALL, join_stream_state_doc},
    {"write_stream_command", gf_py_write_stream_command, METH_VARARGS, write_stream_command_doc},
    {"read_stream_command", (PyCFunction)(void (*)(void))gf_py_read_stream_command, METH_FASTCALL, read_stream_command_doc},
    {"write_stream_state", (PyCFunction)(void (*)(void))gf_py_write_stream_state, METH_FASTCALL, write_stream_state_doc},
    {"is_plausible_state", (PyCFunction)(void (*)(void))gf_py_is_plausible_state, METH_FASTCALL, is_plausible_state_doc},
    {"torque_step_ratio", (PyCFunction)(void (*)(void))gf_py_torque_step_ratio, METH_FASTCALL, torque_step_ratio_doc},
    {"has_finite_sum", (PyCFunction)(void (*)(void))gf_py_has_finite_sum, METH_FASTCALL, has_finite_sum_doc},
    {"slip_margins", (PyCFunction)(void (*)(void))gf_py_slip_margins, METH_FASTCALL, slip_margins_doc},
    {NULL, NULL, 0, NULL},
};
static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)gf_py_add_step_type},
                                   {Py_mod_exec, (void *)gf_py_add_state_flags},
                                   {Py_mod_exec, (void *)gf_py_add_message_code},
                                   {0, NULL}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_native", .m_size = 0, .m_methods = functions,
                                        .m_slots = slots};

PyMODINIT_FUNC PyInit__native(void)
{
    return PyModuleDef_Init(&definition);
}
