"""Steering of a simulation by the controls of its view: the desired pose and the squeeze change without steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from graspforce.browser.live_view import LiveView
from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ObjectController
from graspforce.control.state import DesiredMotion, GraspState, object_motion
from graspforce.core.arrays import Array
from graspforce.geometry.rotations import rotation_exp
from graspforce.simulation.loops.reference import Reference

_RATE = 6.0  # rad/s: the desired pose follows the sliders as a critically damped motion
_LARGEST_CHANGE = 0.02  # N: of the slip margin in one change
_CHANGE_PERIOD = 5  # steps between two changes of the slip margin
_TOLERANCE = 1e-6  # N


class SteeredReference:
    """A reference motion, moved by the sliders of a view.

    Args:
        reference: motion without the sliders.
        view: the view.
    """

    def __init__(self, reference: Reference, view: LiveView) -> None:
        self._reference, self._view = reference, view
        self._t: float | None = None
        self._x, self._v, self._omega = np.zeros(6), np.zeros(6), np.zeros(3)

    def __call__(self, t: float) -> BodyMotion:
        """Return the desired motion at a time.

        Args:
            t: time, s, not before that of the last call.
        """
        desired = object_motion(self._reference(t))
        dt = 0.0 if self._t is None else t - self._t
        self._t = t
        a = _RATE**2 * (self._view.offset - self._x) - 2.0 * _RATE * self._v  # m/s² and rad/s²
        self._v = self._v + dt * a
        self._x = self._x + dt * self._v
        omega = left_jacobian(self._x[3:]) @ self._v[3:]  # rad/s
        alpha = (omega - self._omega) / dt if dt > 0.0 else np.zeros(3)  # rad/s²
        self._omega = omega
        R = np.asarray(rotation_exp(self._x[3:]))
        turned, turned_rate = R @ desired.twist[3:], R @ desired.acceleration[3:]
        return BodyMotion(
            desired.p_HO + self._x[:3],
            R @ desired.R_HO,
            np.concatenate([desired.twist[:3] + self._v[:3], omega + turned]),
            np.concatenate([desired.acceleration[:3] + a[:3], alpha + turned_rate + np.cross(omega, turned)]),
        )


class SteeredController:
    """An object controller whose slip margin follows the slider of a view, in small changes.

    Args:
        controller: the controller.
        view: the view.
    """

    def __init__(self, controller: ObjectController, view: LiveView) -> None:
        self._controller, self._view, self._steps = controller, view, 0

    def reset(self) -> None:
        """Reset the controller to the start."""
        self._controller.reset()

    def step(self, state: GraspState, desired: DesiredMotion, external: npt.ArrayLike | None = None) -> Command:
        """Compute the motor torques for the next period.

        Args:
            state: as in `ObjectController.step`.
            desired: as in `ObjectController.step`.
            external: as in `ObjectController.step`.
        """
        self._steps += 1
        settings, wanted = self._controller.settings, self._view.slip_margin
        change = 0.0 if wanted is None else wanted - settings.slip_margin  # N
        if abs(change) > _TOLERANCE and self._steps % _CHANGE_PERIOD == 0:
            margin = settings.slip_margin + float(np.clip(change, -_LARGEST_CHANGE, _LARGEST_CHANGE))
            self._controller.change_settings(dataclasses.replace(settings, slip_margin=max(margin, 0.0)))
        return self._controller.step(state, desired, external)


def left_jacobian(rotation_vector: Array) -> Array:
    """Return the map from the rate of a rotation vector r to the angular velocity of exp(r), (3, 3).

    J = I + (1 − cos θ)/θ² [r]× + (θ − sin θ)/θ³ [r]×² with θ = ‖r‖.

    Source: Chirikjian (2011), section 10.3.

    Args:
        rotation_vector: (3,) r, rad.
    """
    x, y, z = rotation_vector
    theta = float(np.linalg.norm(rotation_vector))
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if theta < 1e-4:  # rad: the series to second order
        return np.asarray(np.eye(3) + 0.5 * hat + hat @ hat / 6.0)
    first, second = (1.0 - np.cos(theta)) / theta**2, (theta - np.sin(theta)) / theta**3
    return np.asarray(np.eye(3) + first * hat + second * hat @ hat)
