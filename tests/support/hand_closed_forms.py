"""Published closed forms of fingers, corrected, in the finger's base frame F, and the pose of F on the shipped hands.

The hands are computed from URDF files by Pinocchio, without these formulas. "The study" of a hand is its source in
docs/references.bib: DlrHit2Study and DigitalTwinHand.
"""

from __future__ import annotations

from math import cos, pi, radians, sin

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# ── four_finger: Mattar (2013) ─────────────────────────────────────────────────────────────────────────────────────────────

FOUR_FINGER_LENGTHS = (0.030, 0.115, 0.105)  # l1, l2, l3, m


def four_finger_tip_pose(q: Array) -> tuple[Array, Array]:
    """Return the tip frame in F: Mattar (2013), equation (2), with H₁₂ = −C1·S23 and p_z = l3·S23 + l2·S2."""
    l1, l2, l3 = FOUR_FINGER_LENGTHS
    (c1, s1), (c2, s2), (c23, s23) = ((cos(x), sin(x)) for x in (q[0], q[1], q[1] + q[2]))
    psi = l3 * c23 + l2 * c2 + l1
    R = np.array([[c1 * c23, -c1 * s23, s1], [s1 * c23, -s1 * s23, -c1], [s23, c23, 0.0]])
    return np.array([c1 * psi, s1 * psi, l3 * s23 + l2 * s2]), R


def four_finger_tip_jacobian(q: Array) -> Array:
    """Return the Jacobian of the tip velocity in the tip's axes: Mattar (2013), equation (23), as printed."""
    l1, l2, l3 = FOUR_FINGER_LENGTHS
    psi = l3 * cos(q[1] + q[2]) + l2 * cos(q[1]) + l1
    return np.array([[0.0, 0.0, -psi], [l2 * sin(q[2]), l3 + l2 * cos(q[2]), 0.0], [0.0, l3, 0.0]]).T


def four_finger_joint_angles(p: Array) -> Array:
    """Return joint angles, elbow up, for a tip position in F: Mattar (2013), equations (12), (13), θ3 = +acos, with atan2."""
    l1, l2, l3 = FOUR_FINGER_LENGTHS
    q1 = np.arctan2(p[1], p[0])
    along, up = np.hypot(p[0], p[1]) - l1, p[2]
    q3 = np.arccos((along**2 + up**2 - l2**2 - l3**2) / (2 * l2 * l3))
    q2 = np.arctan2(up, along) - np.arctan2(l3 * np.sin(q3), l2 + l3 * np.cos(q3))
    return np.array([q1, q2, q3])


# ── dlr_hit2: DLR-HIT II dual-platform study ───────────────────────────────────────────────────────────────────────────────

DLR_HIT2_LENGTHS = (0.055, 0.025, 0.025)  # L1, L2, L3, m


def dlr_hit2_tip_pose(q: Array) -> tuple[Array, Array]:
    """Return the tip frame in F for (θ1, θ2, θ3), θ4 = θ3: equations (9), (10) with c332 in the L3 terms and s1 in R₁₂."""
    L1, L2, L3 = DLR_HIT2_LENGTHS
    (c1, s1), (c2, s2) = ((cos(x), sin(x)) for x in q[:2])
    (c32, s32), (c332, s332) = ((cos(x), sin(x)) for x in (q[1] + q[2], q[1] + 2 * q[2]))
    reach = L1 * c2 + L2 * c32 + L3 * c332
    R = np.array([[c332 * s1, -s332 * s1, -c1], [s332, c332, 0.0], [c332 * c1, -s332 * c1, s1]])
    return np.array([reach * s1, L1 * s2 + L2 * s32 + L3 * s332, reach * c1]), R


def dlr_hit2_jacobian(q: Array) -> Array:
    """Return the Jacobian of the tip velocity in F by (θ1, θ2, θ3): equation (12), corrected to 3 × 3 by the chain rule."""
    L1, L2, L3 = DLR_HIT2_LENGTHS
    (c1, s1), (c2, s2) = ((cos(x), sin(x)) for x in q[:2])
    (c32, s32), (c332, s332) = ((cos(x), sin(x)) for x in (q[1] + q[2], q[1] + 2 * q[2]))
    reach = L1 * c2 + L2 * c32 + L3 * c332
    d2 = np.array([-(L1 * s2 + L2 * s32 + L3 * s332), reach])  # of (reach, Y) by θ2
    d3 = np.array([-(L2 * s32 + 2 * L3 * s332), L2 * c32 + 2 * L3 * c332])  # by θ3
    return np.array(
        [
            [reach * c1, d2[0] * s1, d3[0] * s1],
            [0.0, d2[1], d3[1]],
            [-reach * s1, d2[0] * c1, d3[0] * c1],
        ]
    )


def dlr_hit2_bodies(q: Array) -> list[tuple[float, Array, Array, Array]]:
    """Return mass, inertia about the centre of mass, centre of mass in F and axes in F of the four moving links.

    From equations (2)–(5). The links are uniform bars along z in the stretched posture.
    """
    th1, th2, th3 = q
    Ry = np.array([[cos(th1), 0, sin(th1)], [0, 1, 0], [-sin(th1), 0, cos(th1)]])

    def curl(angle: float) -> Array:
        c, s = cos(-angle), sin(-angle)
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])

    def bar(m: float, w: float, length: float) -> Array:
        return np.diag([m * (w**2 + length**2) / 12, m * (w**2 + length**2) / 12, m * w**2 / 6])

    along = np.array([0.0, 0.0, 1.0])
    bodies, p = [(0.010, bar(0.010, 0.012, 0.012), np.zeros(3), Ry)], np.zeros(3)
    for mass, width, length, angle in (
        (0.061, 0.020, 0.055, th2),
        (0.025, 0.020, 0.025, th2 + th3),
        (0.024, 0.0192, 0.025, th2 + 2 * th3),
    ):
        R = Ry @ curl(angle)
        bodies.append((mass, bar(mass, width, length), p + R @ along * length / 2, R))
        p = p + R @ along * length
    return bodies


# ── anthropomorphic15: digital-twin hand study ─────────────────────────────────────────────────────────────────────────────

ANTHROPOMORPHIC15_LENGTHS = (0.050, 0.037, 0.030)  # L1, L2, L3, m
ANTHROPOMORPHIC15_MASSES, ANTHROPOMORPHIC15_INERTIAS = (0.020, 0.020, 0.015), (5.67e-6, 4.2e-6, 2.36e-6)  # kg, kg·m²
ANTHROPOMORPHIC15_CENTRES = (0.0423, 0.0298, 0.0270)  # m, along each link: the printed distances minus the links before
ANTHROPOMORPHIC15_PRINTED_CENTRES, ANTHROPOMORPHIC15_DYNAMICS_LENGTHS = (
    (0.0423, 0.0798, 0.1140),
    (0.040, 0.035, 0.023),
)  # m, section 4.3


def anthropomorphic15_tip_pose(q: Array) -> tuple[Array, Array]:
    """Return the tip frame in F: equations (1)–(3), as printed."""
    L1, L2, L3 = ANTHROPOMORPHIC15_LENGTHS
    a1, a12, a123 = np.cumsum(q)
    p = np.array([L3 * cos(a123) + L2 * cos(a12) + L1 * cos(a1), L3 * sin(a123) + L2 * sin(a12) + L1 * sin(a1), 0.0])
    return p, np.array([[cos(a123), -sin(a123), 0.0], [sin(a123), cos(a123), 0.0], [0.0, 0.0, 1.0]])


def anthropomorphic15_torques(
    q: Array,
    v: Array,
    a: Array,
    g: float,
    lengths: tuple[float, ...] = ANTHROPOMORPHIC15_LENGTHS,
    centres: tuple[float, ...] = ANTHROPOMORPHIC15_CENTRES,
) -> Array:
    """Return the torques of equations (16)–(18), with link directions q1, q1 − q2, q1 − q2 + q3 and gravity along F's x.

    Corrected in (16): the gravity term of m1·c1 has the sign of the others, and l3² is c3².
    """
    (m1, m2, m3), (I1, I2, I3), (c1, c2, c3), (l1, l2, _) = (
        ANTHROPOMORPHIC15_MASSES,
        ANTHROPOMORPHIC15_INERTIAS,
        centres,
        lengths,
    )
    (q1, q2, q3), (v1, v2, v3), (a1, a2, a3) = q, v, a
    k, e = m2 * c2 + m3 * l2, m3 * l2 * c3
    C, S = m3 * l1 * c3 * cos(q2 - q3), m3 * l1 * c3 * sin(q2 - q3)
    G12, G123 = k * g * sin(q1 - q2), m3 * c3 * g * sin(q1 - q2 + q3)
    i3 = m3 * c3**2 + I3
    i23 = m3 * (l2**2 + c3**2) + m2 * c2**2 + I2 + I3
    tau1 = (
        C * (a1 - a2 + a3) - S * (v1 - v2 + v3) * (v2 - v3) + C * a1 - S * (v2 - v3) * v1
        + (-2 * e * sin(q3) * v3 - 2 * l1 * k * sin(q2) * v2) * v1
        + (2 * e * cos(q3) + 2 * l1 * k * cos(q2) + (m2 + m3) * l1**2 + m1 * c1**2 + I1 + i23) * a1
        + (2 * e * sin(q3) * v3 + l1 * k * sin(q2) * v2) * v2
        + (e * cos(q3) + i3) * a3 - e * sin(q3) * v3**2
        - (2 * e * cos(q3) + l1 * k * cos(q2) + i23) * a2
        + (m1 * c1 + m2 * l1 + m3 * l1) * g * sin(q1) + G12 + G123
    )  # fmt: skip
    tau2 = (
        -C * a1 + S * (v2 - v3) * v1 + (2 * e * sin(q3) * v3 + l1 * k * sin(q2) * v2) * v1
        - (2 * e * cos(q3) + l1 * k * cos(q2) + i23) * a1 - 2 * e * sin(q3) * v2 * v3
        + (2 * e * cos(q3) + i23) * a2 - (e * cos(q3) + i3) * a3 + e * sin(q3) * v3**2
        + l1 * k * sin(q2) * (v1**2 - v1 * v2) - G12 + S * (v1 - v2 + v3) * v1 - G123
    )  # fmt: skip
    tau3 = (
        C * a1 - S * (v2 - v3) * v1 + i3 * a3 - e * sin(q3) * (v1 - v2) * v3 + (e * cos(q3) + i3) * (a1 - a2)
        + G123 - (S * v1 - e * sin(q3) * (v1 - v2)) * (v1 - v2 + v3)
    )  # fmt: skip
    return np.array([tau1, tau2, tau3])


# ── poses of the base frames F in the hands' base H ────────────────────────────────────────────────────────────────────────


def _columns(x: tuple[float, ...] | Array, y: tuple[float, ...] | Array, z: tuple[float, ...] | Array) -> Array:
    return np.column_stack([x, y, z]).astype(float)


def _thumb(beta: float, gamma: float) -> tuple[Array, Array]:
    """Return the direction of a stretched thumb, and the direction in which it curls."""
    stretched = np.array([sin(beta), -cos(beta) * sin(gamma), cos(beta) * cos(gamma)])
    return stretched, np.array([0.0, cos(gamma), sin(gamma)])


def _bases() -> dict[tuple[str, str], tuple[Array, Array]]:
    found: dict[tuple[str, str], tuple[Array, Array]] = {}
    inclination = radians(40)
    for name, side, y in (
        ("finger_1", 1, 0.0225),
        ("finger_2", 1, -0.0225),
        ("finger_3", -1, -0.0225),
        ("finger_4", -1, 0.0225),
    ):
        x_F, z_F = (-side * cos(inclination), 0.0, sin(inclination)), (-side * sin(inclination), 0.0, -cos(inclination))
        found["four_finger", name] = np.array([side * 0.271, y, 0.032]), _columns(x_F, np.cross(z_F, x_F), z_F)
    e_x, e_y, e_z = np.eye(3)
    for i, name in enumerate(("index", "middle", "ring", "little")):
        found["dlr_hit2", name] = np.array([0.0702, -0.0426 + 0.0284 * i, -0.010]), _columns(e_y, e_z, e_x)
        found["anthropomorphic15", name] = np.array([0.045, -0.033 + 0.022 * i, -0.008]), _columns(e_x, e_z, -e_y)
    along, curl = _thumb(pi / 6, pi / 6)
    found["dlr_hit2", "thumb"] = np.array([0.030, -0.060, -0.010]), _columns(np.cross(curl, along), curl, along)
    along, curl = _thumb(pi / 6, radians(40))
    found["anthropomorphic15", "thumb"] = np.array([0.0, -0.050, -0.008]), _columns(along, curl, np.cross(along, curl))
    return found


FINGER_BASES = _bases()
TIP_POSES = {
    "four_finger": four_finger_tip_pose,
    "dlr_hit2": dlr_hit2_tip_pose,
    "anthropomorphic15": anthropomorphic15_tip_pose,
}
