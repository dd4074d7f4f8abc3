"""Types of the records of errors, solutions and their analysis. Readers ignore fields that they do not know."""

from __future__ import annotations

from typing import Any, Literal

from msgspec import Struct

from graspforce.service.wire import protocol
from graspforce.service.wire.schemas.array_types import Index, NotNegative, Numbers, Rows, Rows3, Vector3, Vector6
from graspforce.service.wire.schemas.request_types import Sequence

Code = Literal[protocol.REFUSAL_CODES + protocol.ERROR_CODES]  # type: ignore[valid-type]


class ErrorReply(Struct, kw_only=True):
    """The record of a Zenoh error reply.

    Args:
        error: code of the error.
        message: text for the user.
        field: path of the field that is wrong; null if there is none.
        sequence: number of the request.
        retry_after: time after which the request may be repeated, s.
    """

    error: Code  # type: ignore[valid-type]
    message: str
    field: str | None
    sequence: Sequence | None = None
    retry_after: NotNegative | None = None


class ReplyEnvelope(Struct, kw_only=True):
    """A reply.

    Args:
        server_seconds: time from receipt to reply at the server, s.
        sequence: number of the request.
    """

    server_seconds: NotNegative
    sequence: Sequence | None = None


class ContactResult(Struct, kw_only=True):
    """Result of one contact.

    Args:
        slip_margin: μ f_n − ‖f_t‖, N.
        friction_used: fraction of the friction that the force uses.
    """

    slip_margin: float | None
    friction_used: float | None


class CertificateRecord(Struct, kw_only=True):
    """The check of a solution, which does not trust the solver.

    Args:
        verified: whether the residuals and the gap are within the tolerance.
        primal_residual: largest violation of a constraint, relative.
        dual_residual: largest violation of a dual constraint, relative.
        gap: bound on the distance of the cost from its optimum, relative.
        tolerance: largest allowed residual.
        proven: rigorous bounds, if they were computed.
    """

    verified: bool
    primal_residual: float
    dual_residual: float
    gap: float
    tolerance: float
    proven: dict[str, Any] | None = None


class MultipliersRecord(Struct, kw_only=True):
    """Multipliers of a proof, with moments about O's origin.

    Args:
        y: of the wrench.
        normal_lower: of the smallest normal forces.
        normal_upper: of the largest normal forces.
        torque_lower: of the smallest torques.
        torque_upper: of the largest torques.
        level: of the bounds that the objective adds.
    """

    y: Numbers
    normal_lower: Numbers
    normal_upper: Numbers
    torque_lower: Numbers
    torque_upper: Numbers
    level: Numbers


class InfeasibilityRecord(Struct, kw_only=True):
    """The proof that no forces exist, and changes with which they exist.

    Args:
        verified: whether the proof holds.
        explanation: the reason as text.
        contacts: indices of the contacts that the proof uses.
        joints: indices of the motors that the proof uses.
        wrench: direction of the wrench in which too little can be supplied, in O.
        multipliers: the proof.
        friction_factor: smallest factor on all friction with which forces exist; null if none was found.
        torque_factor: likewise on all torque limits.
        nearest_wrench: feasible wrench that is nearest, about O, in O, N and N·m.
        reach: sum of normal forces up to which the proof holds, N; null for all forces.
    """

    verified: bool
    explanation: str
    contacts: list[Index]
    joints: list[Index]
    wrench: Vector6
    multipliers: MultipliersRecord
    friction_factor: float | None
    torque_factor: float | None
    nearest_wrench: Vector6 | None
    reach: float | None = None


class SolverRecord(Struct, kw_only=True):
    """The solver of a solution.

    Args:
        backend: its name.
        iterations: number of iterations.
        seconds: time of the solver, s.
    """

    backend: str
    iterations: Index
    seconds: NotNegative


class SolutionRecord(Struct, kw_only=True):
    """A solution of a force problem.

    Args:
        schema: name and version of the record.
        status: verdict; only verified results are optimal or infeasible.
        objective: value of the objective; null without forces.
        objective_gap: bound on its distance from the optimum; null without forces.
        forces: force of each contact in its frame: f_t1, f_t2, f_n, and m_n of soft contacts, N and N·m.
        forces_object: force of each contact in O, N.
        torques: motor torques, N·m; empty without a hand.
        contacts: result of each contact.
        certificate: check of the solution or of the proof.
        infeasibility: why there are no forces; null if there are.
        solver: the solver.
        joints: names of the joints in the order of the torques, if a hand is named.
        robust: certificate for errors of the problem, if it has an uncertainty.
        timed_out: true if the deadline of the solver passed: the answer is that of its last certified problem.
    """

    schema: Literal["graspforce/solution/1"]
    status: Literal["optimal", "inaccurate", "infeasible", "failed"]
    objective: float | None
    objective_gap: float | None
    forces: Rows
    forces_object: Rows3
    torques: Numbers
    contacts: list[ContactResult]
    certificate: CertificateRecord | None
    infeasibility: InfeasibilityRecord | None
    solver: SolverRecord
    joints: list[str] | None = None
    robust: dict[str, Any] | None = None
    timed_out: bool = False


class SolutionReply(SolutionRecord, kw_only=True):
    """The reply to `solve` and to `hands/<hand>/distribute`.

    Args:
        server_seconds: time from receipt to reply at the server, s.
        sequence: number of the request.
    """

    server_seconds: NotNegative
    sequence: Sequence | None = None


class LimitRecord(Struct, kw_only=True):
    """Use of a limit.

    Args:
        name: contact or joint.
        kind: kind of the limit.
        used: fraction of the limit that is used.
        value: friction needed, normal force in N, or torque in N·m.
        limit: the limit, in the same unit.
        margin: slip margin in N, or remainder to the limit.
    """

    name: str
    kind: str
    used: float | None
    value: float | None
    limit: float | None
    margin: float | None


class LargestWrenchRecord(Struct, kw_only=True):
    """The largest wrench along a direction.

    Args:
        amount: factor on the direction; null without a bound.
        wrench: the wrench about O, in O, N and N·m; null without a bound.
    """

    amount: float | None
    wrench: Vector6 | None


class ExplainReply(ReplyEnvelope, kw_only=True):
    """The reply to `explain`. Numbers that were not found in time are null.

    Args:
        schema: name and version of the record.
        status: verdict of the force problem.
        sentences: the explanation as text.
        limits: use of every limit, the fullest first; empty without forces.
        slip_margin: largest slip margin that all contacts can keep at once, N.
        friction_factor: smallest factor on all friction with which forces exist.
        torque_factor: smallest factor on all torque limits with which forces exist.
        wrench_fraction: largest factor on the wrench with which forces exist.
        payload: largest further wrench along the direction.
        nearest_wrench: feasible wrench that is nearest to an infeasible one, about O, in O, N and N·m.
        solution: the solution of least cost, or the proof of infeasibility.
    """

    schema: Literal["graspforce/explanation/1"]
    status: Literal["optimal", "inaccurate", "infeasible", "failed"]
    sentences: list[str]
    limits: list[LimitRecord]
    slip_margin: float | None
    friction_factor: float | None
    torque_factor: float | None
    wrench_fraction: float | None
    payload: LargestWrenchRecord | None
    nearest_wrench: Vector6 | None
    solution: SolutionRecord


class EllipsoidRecord(Struct, kw_only=True):
    """An ellipsoid.

    Args:
        axes: unit vectors along its semi-axes, by rows.
        sizes: lengths of the semi-axes.
    """

    axes: Rows
    sizes: Numbers


class BallRecord(Struct, kw_only=True):
    """Bounds on the radius of a ball of wrenches.

    Args:
        lower: lower bound, N.
        upper: upper bound, N.
        weakest: direction in which the set is smallest.
    """

    lower: float
    upper: float
    weakest: Vector6


class RegionRecord(Struct, kw_only=True):
    """How far a contact may move along the object's surface.

    Args:
        contact: index of the contact.
        kept: property of the grasp that the region keeps.
        points: ends of lines along the surface in O, m; their directions turn from t₁ to t₂ in equal steps.
        distances: their lengths along the surface, m.
        ends: why each line ends: the property is lost, the surface has an edge, or the largest distance is reached.
    """

    contact: Index
    kept: Literal["closure", "payload"]
    points: list[Vector3]
    distances: Numbers
    ends: list[Literal["lost", "edge", "limit"]]


class QualityReply(ReplyEnvelope, kw_only=True):
    """The reply to `quality`. Measures that did not fit in the budget are null.

    Args:
        schema: name and version of the record.
        length: characteristic length that divides moments, m.
        rank: rank of the grasp matrix.
        force_closed: whether the grasp is force-closed.
        form_closed: whether it is closed without friction.
        wrench_ellipsoid: wrenches of contact forces of norm 1 N.
        smallest_singular_value: smallest singular value of the grasp matrix.
        isotropy: smallest over largest singular value.
        epsilon_sum: ball of wrenches with a sum of normal forces of 1 N.
        epsilon_each: ball of wrenches with normal forces up to 1 N each.
        epsilon_limits: ball of wrenches within all limits.
        disturbance: ball of wrenches in addition to the problem's, within all limits.
        volume: `lower` and `upper` bound on the volume of wrenches.
        contact_errors: errors of `position` (m) and `normal` (rad) of each contact that closure survives.
        payload_errors: the same that the payload survives.
        closure_regions: regions of the contacts that keep closure, as far as these fitted in the budget; null without a shape.
        payload_regions: regions of the contacts that keep the payload, likewise.
        payload: largest wrench along the direction.
        fingers: ellipsoids of `velocity` and `force` of the hand at each contact.
        object_motion: ellipsoid of the object's motion.
    """

    schema: Literal["graspforce/quality/1"]
    length: float
    rank: Index
    force_closed: bool | None
    form_closed: bool | None
    wrench_ellipsoid: EllipsoidRecord
    smallest_singular_value: float
    isotropy: float
    epsilon_sum: BallRecord | None
    epsilon_each: BallRecord | None
    epsilon_limits: BallRecord | None
    disturbance: BallRecord | None
    volume: dict[str, float] | None
    contact_errors: dict[str, Numbers] | None
    payload_errors: dict[str, Numbers] | None
    closure_regions: list[RegionRecord] | None
    payload_regions: list[RegionRecord] | None
    payload: LargestWrenchRecord | None
    fingers: list[dict[str, EllipsoidRecord]]
    object_motion: EllipsoidRecord | None
