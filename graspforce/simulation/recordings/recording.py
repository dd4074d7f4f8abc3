"""Recordings of simulations: all steps in read-only arrays, which are saved to NumPy archives and loaded again."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact import friction
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.whole_file import replace_file
from graspforce.hand.hand import Hand
from graspforce.learning.actions.labels import LABEL_RATE, MotionLabel, label_motions
from graspforce.learning.actions.segmentation import GistSettings

_SCHEMA = "graspforce/recording/1"
_TEXT_FIELDS = ("hand", "fingers", "joints", "warnings", "collisions", "grasp")
_STATIC_ARRAYS = ("torque_lower", "torque_upper")  # without a row for each step
_FILE_KEYS = {"forces_reused": "held"}  # fields with another key in the file


@dataclass(frozen=True, eq=False)
class Recording:
    """A simulation of s steps with n motors and N contacts.

    Row i of an array holds the state at t[i], and the torques and forces of the step that begins at t[i].

    Attributes:
        hand: name of the hand.
        fingers: N names.
        joints: n names of the motors' joints.
        warnings: (t, text): warnings of the controller, each at the first of the consecutive steps that repeat it.
        t: (s,) time, s.
        q: (s, n) true joint positions, rad.
        v: (s, n) true joint rates, rad/s.
        p_HO: (s, 3) true position of the object in H, m.
        R_HO: (s, 3, 3) true orientation of the object in H.
        twist: (s, 6) true twist of the object in H, m/s and rad/s.
        p_desired: (s, 3) position of the reference, m.
        R_desired: (s, 3, 3) orientation of the reference.
        twist_desired: (s, 6) twist of the reference.
        tau_command: (s, n) commanded torques, N·m.
        tau: (s, n) torques at the joints, N·m.
        torque_lower: (n,) lower torque limits, N·m.
        torque_upper: (n,) upper torque limits, N·m.
        planned: (s, N, 4) contact forces of the controller, padded, N and N·m.
        planned_R_OC: (s, N, 3, 3) their contact frames in O.
        planned_margin: (s, N) their slip margins, N.
        touching: (s, N) 1 for a fingertip in contact, otherwise 0.
        f: (s, N, 4) contact forces of the plant, padded, N and N·m.
        p_OC: (s, N, 3) contact points of the plant in O, m.
        R_OC: (s, N, 3, 3) contact frames of the plant in O.
        mu: (s, N) coefficients of friction of the plant.
        gamma: (s, N) torsional friction lengths of the plant, m.
        depth: (s, N) penetration of the surfaces in the engine, m.
        forces_reused: (s,) 1 if the controller reused its last forces.
        saturated: (s,) 1 if a motor was at its limit.
        collisions: (t, first, second, force): contacts of links or palm with the object, the floor or other links, each at the
            first of the consecutive steps with it, with the largest normal force in these, N.
        grasp: record of the grasp at the start, for `Grasp.from_dict`; None if it is not known.
    """

    hand: str
    fingers: tuple[str, ...]
    joints: tuple[str, ...]
    warnings: tuple[tuple[float, str], ...]
    t: Array
    q: Array
    v: Array
    p_HO: Array
    R_HO: Array
    twist: Array
    p_desired: Array
    R_desired: Array
    twist_desired: Array
    tau_command: Array
    tau: Array
    torque_lower: Array
    torque_upper: Array
    planned: Array
    planned_R_OC: Array
    planned_margin: Array
    touching: Array
    f: Array
    p_OC: Array
    R_OC: Array
    mu: Array
    gamma: Array
    depth: Array
    forces_reused: Array
    saturated: Array
    collisions: tuple[tuple[float, str, str, float], ...] = ()
    grasp: JsonRecord | None = None

    @property
    def position_error(self) -> Array:
        """(s, 3) true minus desired position, in H, m."""
        return np.asarray(self.p_HO - self.p_desired)

    @property
    def orientation_error(self) -> Array:
        """(s, 3) rotation vector from the desired to the true orientation, in H, rad."""
        return np.asarray((Rotation.from_matrix(self.R_HO) * Rotation.from_matrix(self.R_desired).inv()).as_rotvec())

    @property
    def slip_margin(self) -> Array:
        """(s, N) slip margins of the plant's forces, μ f_n − ‖f_t‖ for point contacts, N."""
        return friction.slip_margin(self.f, self.mu, self.gamma)

    @property
    def violation(self) -> Array:
        """(s, N) distances of the plant's forces from their friction cones, N; zero inside."""
        return friction.violation(self.f, self.mu, self.gamma)

    def motion_labels(self, hand: Hand, settings: GistSettings | None = None) -> tuple[MotionLabel, ...]:
        """Return the motions of all fingers, in the order in which they begin; none for a recording of less than 0.02 s.

        Args:
            hand: the hand of the recording.
            settings: parameters of the segmentation, as in `label_motions`.

        Raises:
            InvalidInput: the hand has other joints.
        """
        if self.t[-1] - self.t[0] < 2.0 / LABEL_RATE:
            return ()
        return label_motions(hand, self.t, self.q, settings=settings)

    def since(self, start: float) -> Recording:
        """Return the part from a time on.

        Args:
            start: time of the first step, s.
        """
        kept = self.t >= start
        rows: dict[str, Any] = {
            name: freeze(getattr(self, name)[kept]) for name in _array_names() if name not in _STATIC_ARRAYS
        }
        warnings = tuple((t, text) for t, text in self.warnings if t >= start)
        collisions = tuple(each for each in self.collisions if each[0] >= start)
        return dataclasses.replace(self, warnings=warnings, collisions=collisions, **rows)

    def save(self, path: str | os.PathLike[str], more: Mapping[str, Array] | None = None) -> None:
        """Write a compressed NumPy archive (.npz), which `load` and `numpy.load` read.

        Args:
            path: the file.
            more: further arrays by name, which `load` ignores.
        """
        words = {"schema": _SCHEMA, **{name: getattr(self, name) for name in _TEXT_FIELDS}}
        arrays = {_FILE_KEYS.get(name, name): getattr(self, name) for name in _array_names()}
        with replace_file(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, words=np.array(json.dumps(words)), **arrays, **(more or {}))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Recording:
        """Return a recording that `save` wrote.

        Args:
            path: the file.

        Raises:
            InvalidInput: the file is missing, or is not a recording.
        """
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
                words = json.loads(str(archive["words"]))
                arrays = {name: freeze(archive[_FILE_KEYS.get(name, name)]) for name in _array_names()}
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            reason = "it is no archive of NumPy" if isinstance(error, ValueError) else error  # NumPy speaks of pickles
            raise InvalidInput("path", str(path), f"a recording: {reason}") from None
        if words.pop("schema", None) != _SCHEMA:
            raise InvalidInput("path", str(path), f"a recording of schema {_SCHEMA}")
        warnings = tuple((float(t), str(text)) for t, text in words["warnings"])
        collisions = tuple((float(t), str(a), str(b), float(force)) for t, a, b, force in words.get("collisions", ()))
        hand, grasp = words["hand"], words.get("grasp")
        fingers, joints = tuple(words["fingers"]), tuple(words["joints"])
        return cls(hand, fingers, joints, warnings, **arrays, collisions=collisions, grasp=grasp)


def _array_names() -> list[str]:
    """Return the names of the array fields."""
    return [each.name for each in dataclasses.fields(Recording) if each.name not in _TEXT_FIELDS]
