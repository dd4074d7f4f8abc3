"""The numbers of a state of a stream in one block: joined from the arrays of the wire, checked together, and viewed as arrays.

A block that is refused here may still be valid: then `StreamState.from_dict` reads the state field by field.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import Any

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control import DesiredMotion, GraspMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native
from graspforce.core.constants import LARGEST_DISTANCE
from graspforce.core.records import unchecked_constructor
from graspforce.service.wire import protocol
from graspforce.service.wire.state_structs import MotionStruct

Extra = tuple[tuple[str, tuple[int, ...]], ...]
"""Names and shapes of the arrays of a state beyond those of an exact one."""

_LAYOUTS = 64  # kept; clients decide which ones occur
_OBJECT_NUMBERS = 18  # position, rotation and twist of the object
STACKED_NUMBERS = "measured"
"""Field of the block of a state: joint positions and rates, and position, rotation and twist of the object."""

_make_motion = unchecked_constructor(BodyMotion)
_make_grasp_motion = unchecked_constructor(GraspMotion)


def read_block(
    now: tuple[Any, ...],
    motion: MotionStruct[Any, Any],
    external: Any,
    n: int,
    extra: Extra = (),
    further: tuple[Any, ...] = (),
) -> Block:
    """Return the checked block of a state. An array of the wire is bytes of float64, or a list, of rows for a matrix.

    Args:
        now: positions and rates of the joints, and position, rotation and twist of the object.
        motion: the desired motion.
        external: the external wrench, or None.
        n: number of joints of the hand.
        extra: as in `block_layout`.
        further: the arrays of `extra`.

    Raises:
        ValueError: a shape or a rotation is wrong, or a number is not finite or may be out of range.
        TypeError: a number is no float.
    """
    joints = motion.joints
    parts = (
        *(*now, motion.position, motion.rotation, motion.twist, motion.acceleration),
        *(() if joints is None else (joints.posture, joints.velocity, joints.acceleration)),
        *(() if external is None else (external,)),
        *further,
    )
    sizes = n, joints is not None, external is not None, extra
    join = _join_parts if native is None else native.join_stream_state
    numbers: bytes | None = join(parts, _part_shapes(*sizes), n)
    if numbers is None:
        raise ValueError("a number is not finite, or an array has the wrong shape")
    check_usual(numbers)
    return view_block(numbers, *sizes)


def view_block(numbers: bytes, n: int, joints: bool, external: bool, extra: Extra = ()) -> Block:
    """Return the numbers of a state as a block.

    Args:
        numbers: bytes of the numbers.
        n: as in `block_layout`.
        joints: as in `block_layout`.
        external: as in `block_layout`.
        extra: as in `block_layout`.
    """
    block: Block = np.ndarray((), block_layout(n, joints, external, extra), numbers)
    return block


def view_desired(block: Block, joints: bool, external: bool) -> tuple[DesiredMotion, Array | None]:
    """Return the desired motion and the external wrench of a block; None for no wrench.

    Args:
        block: the block of a state.
        joints: as in `block_layout`.
        external: as in `block_layout`.
    """
    desired: DesiredMotion = _make_motion(block["p_d"], block["R_d"], block["twist_d"], block["acceleration_d"])
    if joints:
        desired = _make_grasp_motion(desired, block["q_d"], block["v_d"], block["a_d"])
    return desired, block["external"] if external else None


def check_usual(numbers: bytes) -> None:
    """Check that the numbers of a state are in the range that all of them may have.

    Args:
        numbers: bytes of finite float64 numbers.

    Raises:
        ValueError: a number may be out of range.
    """
    if native is not None:
        is_usual = native.is_plausible_state(numbers, None, 0.0, usual_range(len(numbers) // protocol.FLOAT_BYTES))
    else:
        is_usual = np.abs(np.frombuffer(numbers)).max() <= LARGEST_DISTANCE
    if not is_usual:
        raise ValueError("a number may be out of range")


@cache
def usual_range(count: int) -> Array:
    """Return the rules of numbers within the least of all bounds, as `is_plausible_state` in C takes them, (4, count).

    Args:
        count: number of numbers.
    """
    return np.repeat([[0.0], [LARGEST_DISTANCE], [math.inf], [math.inf]], count, axis=1)


def _block_fields(n: int, joints: bool, external: bool, extra: Extra) -> list[tuple[str, tuple[int, ...]]]:
    """Return the names and shapes of a state's arrays in their order on the wire, for a hand with n joints."""
    motion = [("p_d", (3,)), ("R_d", (3, 3)), ("twist_d", (6,)), ("acceleration_d", (6,))]
    shapes: list[tuple[str, tuple[int, ...]]] = [("q", (n,)), ("v", (n,)), ("p_HO", (3,)), ("R_HO", (3, 3)), ("twist", (6,))]
    shapes += motion
    shapes += [(name, (n,)) for name in ("q_d", "v_d", "a_d")] if joints else []
    shapes += [("external", (6,))] if external else []
    return [*shapes, *extra]


@lru_cache(_LAYOUTS)
def _part_shapes(n: int, joints: bool, external: bool, extra: Extra) -> tuple[tuple[int, int], ...]:
    """Return rows and columns of a state's arrays; a vector has one row."""
    return tuple((1 if len(shape) == 1 else shape[0], shape[-1]) for _, shape in _block_fields(n, joints, external, extra))


@lru_cache(_LAYOUTS)
def block_layout(n: int, joints: bool, external: bool, extra: Extra = ()) -> np.dtype[np.void]:
    """Return the layout of a state's numbers. Its field `STACKED_NUMBERS` overlaps the five arrays that were measured.

    Args:
        n: number of joints.
        joints: whether the state has desired joint motions.
        external: whether it has an external wrench.
        extra: further arrays at its end.
    """
    given = _block_fields(n, joints, external, extra)
    sizes = [protocol.FLOAT_BYTES * math.prod(shape) for _, shape in given]
    return np.dtype(
        {
            "names": [STACKED_NUMBERS, *(name for name, _ in given)],
            "formats": [("f8", (2 * n + _OBJECT_NUMBERS,)), *(("f8", shape) for _, shape in given)],
            "offsets": [0, *(sum(sizes[:i]) for i in range(len(sizes)))],
            "itemsize": sum(sizes),
        }
    )


def _join_parts(parts: tuple[Any, ...], shapes: tuple[tuple[int, int], ...], n: int) -> bytes | None:
    """Return the float64 numbers of a state's arrays; None if one is not finite, or a matrix is no rotation.

    Raises:
        ValueError: an array has the wrong shape.
    """
    joined = b"".join(map(_to_bytes, parts, shapes))
    numbers = np.frombuffer(joined).tolist()
    # The sum is finite only if all numbers are. If it overflows, the slow path decides.
    is_valid = math.isfinite(sum(numbers)) and all(
        arrays.is_rotation(numbers[start : start + 9]) for start in (2 * n + 3, 2 * n + 21)
    )
    return joined if is_valid else None


def _to_bytes(values: Any, shape: tuple[int, int]) -> bytes:
    """Return the float64 bytes of an array: bytes, or a list, with a list for each row of a matrix.

    Raises:
        ValueError: it has another shape.
    """
    if type(values) is bytes:
        joined = values
    else:
        numbers = np.array(values, dtype=np.float64)
        if numbers.shape not in (shape, shape[1:]) or (numbers.ndim == 2 and shape[0] == 1):
            raise ValueError("an array has the wrong shape")
        joined = numbers.tobytes()
    if len(joined) != protocol.FLOAT_BYTES * math.prod(shape):
        raise ValueError("an array has the wrong size")
    return joined
