"""Measurements in typed structs, and their fast reading.

The numbers are joined and checked as those of an exact state, whose block has a motion of the object. A measured pose takes its
place; without one, the object rests at the origin.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from graspforce.control import DesiredMotion
from graspforce.core.arrays import Array
from graspforce.core.records import unchecked_constructor
from graspforce.estimation.measurement import LARGEST_TIME, Measurement, PoseMeasurement
from graspforce.service.wire import protocol
from graspforce.service.wire.state_block import Extra, read_block, view_desired
from graspforce.service.wire.state_structs import MeasurementStruct, MotionStruct, PoseStruct

_ORIGIN, _AXES, _NO_TWIST = np.zeros(3).tobytes(), np.eye(3).tobytes(), np.zeros(6).tobytes()
_NOT_MEASURED = dict.fromkeys(("tau", "current", "tip_wrench", "contact_points"))

_make_measurement = unchecked_constructor(Measurement)


def read_measured(
    measured: MeasurementStruct[Any, Any], motion: MotionStruct[Any, Any], external: Any, n: int
) -> tuple[Measurement, DesiredMotion, Array | None]:
    """Return the measurement, the desired motion and the external wrench of a state.

    Args:
        measured: the measurement.
        motion: the desired motion.
        external: the external wrench, or None.
        n: number of joints of the hand.

    Raises:
        ValueError: a number, a shape or a rotation is wrong, or may be.
        TypeError: a number is no float.
    """
    if not abs(measured.t) <= LARGEST_TIME:
        raise ValueError("a time is out of range")
    pose, velocity = measured.object, measured.velocity
    extra, further = _further_parts(measured, n)
    now = (
        *(measured.posture, bytes(protocol.FLOAT_BYTES * n) if velocity is None else velocity),
        *(*((_ORIGIN, _AXES) if pose is None else (pose.position, pose.rotation)), _NO_TWIST),
    )
    block = read_block(now, motion, external, n, extra, further)
    found = {name: block[name] for name, _ in extra}
    body = None if pose is None else PoseMeasurement(pose.t, block["p_HO"], block["R_HO"], found.pop("covariance", None))
    v = None if velocity is None else block["v"]
    given = _make_measurement(t=measured.t, q=block["q"], v=v, object=body, **{**_NOT_MEASURED, **found})
    return given, *view_desired(block, motion.joints is not None, external is not None)


def write_measurement(measured: Measurement) -> MeasurementStruct[bytes, bytes]:
    """Return the wire form of a measurement with binary arrays.

    Args:
        measured: the measurement.
    """
    pose = measured.object
    body = None
    if pose is not None:
        body = PoseStruct(pose.t, pose.p_HO.tobytes(), pose.R_HO.tobytes(), _to_bytes(pose.covariance))
    return MeasurementStruct(
        *(measured.t, measured.q.tobytes(), _to_bytes(measured.v), _to_bytes(measured.tau), _to_bytes(measured.current)),
        *(_to_bytes(measured.tip_wrench), _to_bytes(measured.contact_points), body),
    )


def _to_bytes(array: Array | None) -> bytes | None:
    """Return the numbers of an array; None for None."""
    return None if array is None else array.tobytes()


def _further_parts(measured: MeasurementStruct[Any, Any], n: int) -> tuple[Extra, tuple[Any, ...]]:
    """Return names and shapes of the arrays of a measurement that an exact state has not, and these arrays."""
    pose, wrenches, points = measured.object, measured.tip_wrenches, measured.contact_points
    shapes: list[tuple[str, tuple[int, ...]]] = []
    parts: list[Any] = []
    for name, given in (("tau", measured.torque), ("current", measured.current)):
        if given is not None:
            shapes.append((name, (n,)))
            parts.append(given)
    rows = {}
    for name, given, width in (("tip_wrench", wrenches, 6), ("contact_points", points, 3)):
        if given is not None:
            rows[name] = len(given) // (protocol.FLOAT_BYTES * width) if type(given) is bytes else len(given)
            shapes.append((name, (rows[name], width)))
            parts.append(given)
    if len(set(rows.values())) > 1:
        raise ValueError("different numbers of contacts")
    if pose is not None and pose.covariance is not None:
        shapes.append(("covariance", (6, 6)))
        parts.append(pose.covariance)
    return tuple(shapes), tuple(parts)
