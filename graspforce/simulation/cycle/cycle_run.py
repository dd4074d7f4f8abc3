"""Simulation of a grasp cycle: a hand, an object on a table, and the phase controller, in a world."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.phase_step import PhaseCommand, PhaseRecord
from graspforce.control.state import GraspState
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement
from graspforce.geometry.rotations import rotation_exp
from graspforce.geometry.vectors import table_axes
from graspforce.simulation.cycle.rest import resting_pose
from graspforce.simulation.cycle.table_scene import TableScene
from graspforce.simulation.plants.driven_plant import DrivenPlant, step_plant
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.plant_interface import LinkCollision
from graspforce.simulation.sensors.measurement_reader import MeasurementReader
from graspforce.simulation.worlds.world import World
from graspforce.simulation.worlds.world_plants import make_plant, with_drives

_TIME_AFTER_STOP = 0.5  # s, simulated after the cycle has stopped or is done
_PUSH_DELAY = 0.2  # s after the begin of the move at which the world's pushes begin
# rad, of the object: MuJoCo's collision of a plane with a cylinder may miss faces that are parallel up to rounding
_TILT = 1e-6

StepCallback = Callable[[Plant, PhaseCommand], bool | None]


class CycleController(Protocol):
    """A controller of a cycle: `PhaseController`, or one that runs in a service."""

    @property
    def plan(self) -> CyclePlan: ...  # pragma: no cover
    @property
    def phase(self) -> str: ...  # pragma: no cover
    @property
    def records(self) -> tuple[PhaseRecord, ...]: ...  # pragma: no cover
    @property
    def is_over(self) -> bool: ...  # pragma: no cover

    def reset(self) -> None:
        """Return to the start of the cycle."""

    def step(self, measurement: Measurement) -> PhaseCommand:
        """Return the command of a control period."""
        ...  # pragma: no cover


@dataclass(frozen=True, eq=False, slots=True)
class CycleRecording:
    """The steps of a cycle. Arrays have K rows, one for each step.

    Attributes:
        scene: the scene that the controller knows.
        world: the world.
        records: phases that ended, in order.
        message: why the cycle stopped; empty if it is done.
        t: (K,) begin of each step, s.
        phase: name of the phase of each step.
        tau: (K, n) joint torques of the commands, N·m.
        q: (K, n) true joint positions, rad.
        p_HO: (K, 3) true position of the object in H, m.
        R_HO: (K, 3, 3) true axes of the object in H.
        base: (K, 3) displacement of the base from its start, in H, m.
        lift: (3,) planned displacement of the base in the lift, in H, m.
        f: (K, N, 3) true forces of the fingers on the object in the contact frames, N.
        contact_force_H: (K, 3) their sum in H, N.
        mu: (N,) true coefficients of friction.
        table_force: (K,) true normal force of the table on the object, N.
        link_force: (K,) largest true force of other links on the object, N.
        f_planned: (K, N) planned normal forces, N.
        slip_margin: (K,) least slip margin of the planned forces, N; NaN without planned forces.
        touch: (N,) time at which each finger's contact was detected, s; NaN for none.
        first_touch: (N,) time at which each fingertip truly touched the object first, s; NaN for none.
        weight: true weight of the object, N.
    """

    scene: TableScene
    world: World
    records: tuple[PhaseRecord, ...]
    message: str
    t: Array
    phase: tuple[str, ...]
    tau: Array
    q: Array
    p_HO: Array
    R_HO: Array
    base: Array
    lift: Array
    f: Array
    contact_force_H: Array
    mu: Array
    table_force: Array
    link_force: Array
    f_planned: Array
    slip_margin: Array
    touch: Array
    first_touch: Array
    weight: float

    @property
    def is_done(self) -> bool:
        """Whether the controller ended all phases."""
        return not self.message

    def steps_of(self, *phases: str) -> npt.NDArray[np.intp]:
        """Return the indices of the steps of phases.

        Args:
            *phases: names of the phases.
        """
        return np.flatnonzero([name in phases for name in self.phase])


class TablePlant:
    """The plant of a table scene in a world: the object rests on the table, displaced from where the controller expects it.

    The hand's base is prescribed: the plant's frame stays H, the table moves the other way, and gravity contains the base's
    acceleration; see `Plant.move_base`.

    Args:
        scene: the scene that the controller knows.
        world: the world.
        pose: true pose of the object's surface frame, p_HO in m and R_HO; balls and superquadrics roll from there into rest.
        q: (n,) start posture, rad.

    Attributes:
        plant: the plant of hand and object.
        weight: true weight of the object, N.
    """

    def __init__(self, scene: TableScene, world: World, pose: tuple[Array, Array], q: Array) -> None:
        options = world.plant_options(scene.grasp, scene.gravity_H)
        self.inner = make_plant(scene.grasp, options, floor=scene.height)
        plant = with_drives(self.inner, world, scene.grasp)
        assert isinstance(plant, Plant | DrivenPlant)  # not of a URDF
        self.plant = plant
        self.weight = float(np.linalg.norm(scene.gravity_H) * (options.body or scene.grasp.body).mass)
        self._pushes = [(np.array(push[:3]), push[4]) for push in world.pushes]
        self._push_start: float | None = None
        R_OG = Rotation.from_rotvec(np.array(options.shape_turn)).as_matrix()  # G: frame of the surface
        p_GM = R_OG.T @ ((options.body or scene.grasp.body).p_OM - options.shape_offset)
        p_HG, R_HG = resting_pose(scene.grasp.body.shape, p_GM, pose, scene.down)
        R_HO = rotation_exp(_TILT * table_axes(scene.down)[0]) @ R_HG @ R_OG.T
        self.plant.reset(np.zeros(scene.grasp.contacts.size))  # the fingers do not touch yet, so they need not hold the object
        self.inner.place(q, p_HG - R_HO @ options.shape_offset, R_HO)

    def step(self, command: PhaseCommand, active: PhaseCommand) -> None:
        """Advance by a period.

        Args:
            command: the newest command, whose base motion the arm follows.
            active: the command whose torques act now.
        """
        self.inner.move_base(command.base.p, command.base.a)
        if command.phase == "move" and self._push_start is None:
            self._push_start = self.plant.t + _PUSH_DELAY
        self._push()
        step_plant(self.plant, active)

    def _push(self) -> None:
        """Apply the world's pushes in the move phase."""
        plant = self.inner
        plant.external_wrench = np.zeros(6)
        if self._push_start is None:
            return
        for force, duration in self._pushes:
            if self._push_start <= plant.t < self._push_start + duration:
                plant.external_wrench = np.append(force, np.zeros(3))

    def table_force(self) -> float:
        """Return the normal force of the table on the object, N."""
        pairs = self.inner.true_contacts().collisions
        return sum(each.force for each in pairs if {each.first, each.second} == {"object", "floor"})

    def link_force(self) -> float:
        """Return the largest force of a link that is no fingertip on the object, N."""
        pairs = self.inner.true_contacts().collisions
        return max((each.force for each in pairs if "object" in _names(each) and "floor" not in _names(each)), default=0.0)


class _Builder:
    """The rows of a recording during the simulation.

    Args:
        table: the plant.
        fingers: number of fingers.
    """

    def __init__(self, table: TablePlant, fingers: int) -> None:
        self._table = table
        self._rows: dict[str, list[npt.ArrayLike]] = {}
        self._phases: list[str] = []
        self._touch, self._first = np.full(fingers, np.nan), np.full(fingers, np.nan)

    def add(self, t: float, state: GraspState, command: PhaseCommand) -> None:
        """Add a step after it was simulated.

        Args:
            t: begin of the step, s.
            state: the true state at that time.
            command: the newest command.
        """
        contacts = self._table.plant.true_contacts()
        force_O = np.einsum("nij,nj->i", contacts.R_OC, contacts.f[:, :3])  # N
        row: dict[str, npt.ArrayLike] = {
            "t": t,
            "tau": command.tau,
            "q": state.q,
            "p_HO": state.object.p_HO,
            "R_HO": state.object.R_HO,
            "base": command.base.p,
            "f": contacts.f[:, :3],
            "contact_force_H": state.object.R_HO @ force_O,
            "table_force": self._table.table_force(),
            "link_force": self._table.link_force(),
            "f_planned": command.f_normal,
            "slip_margin": command.slip_margin,
        }
        for name, value in row.items():
            self._rows.setdefault(name, []).append(value)
        self._phases.append(command.phase)
        self._first = np.where(np.isnan(self._first) & contacts.touching, t, self._first)
        is_found = np.array([bool(sign) for sign in command.touching])
        self._touch = np.where(np.isnan(self._touch) & is_found, t, self._touch)

    def finish(self, controller: CycleController, scene: TableScene, world: World, message: str) -> CycleRecording:
        """Return the recording.

        Args:
            controller: the controller at the end.
            scene: the scene that it knows.
            world: the world.
            message: why the cycle stopped; empty if it is done.
        """
        return CycleRecording(
            scene=scene,
            world=world,
            records=tuple(controller.records),
            message=message,
            phase=tuple(self._phases),
            lift=controller.plan.lift,
            mu=self._table.plant.true_contacts().mu,
            touch=freeze(self._touch),
            first_touch=freeze(self._first),
            weight=self._table.weight,
            **{name: freeze(np.array(column)) for name, column in self._rows.items()},
        )


def run_cycle(
    table: TablePlant,
    controller: CycleController,
    scene: TableScene,
    world: World,
    *,
    duration: float = 40.0,
    on_step: StepCallback = lambda plant, command: None,
) -> CycleRecording:
    """Simulate a cycle until the controller is done or has stopped, and 0.5 s further.

    Args:
        table: the plant at its start.
        controller: the controller; it is reset.
        scene: the scene that the controller knows.
        world: sensors, delay and seed.
        duration: longest simulated time, s.
        on_step: called after each step; if it returns False, the run ends.
    """
    plant = table.plant
    period, delay = round(1.0 / (world.sensors.rate * plant.dt)), round(world.sensors.latency / plant.dt)
    reader = MeasurementReader(world, scene.grasp)
    controller.reset()
    builder = _Builder(table, len(scene.grasp.fingers))
    pending: deque[tuple[int, PhaseCommand]] = deque()
    command = active = controller.step(reader.read(plant))
    end, cause = np.inf, f"the simulation ended after {duration:g} s"
    for k in range(round(duration / plant.dt)):
        t = k * plant.dt
        reader.observe(plant)
        if k % period == 0 and k > 0:
            command = controller.step(reader.read(plant))
        if k % period == 0:
            pending.append((k + delay, command))
        while pending and pending[0][0] <= k:
            active = pending.popleft()[1]
        state = plant.state()
        table.step(command, active)
        builder.add(t, state, command)
        if on_step(table.inner, command) is False:
            cause = f"the callback ended the simulation after {t + plant.dt:.4g} s"
            break
        if controller.is_over:
            end = min(end, t + _TIME_AFTER_STOP)
        if t >= end:
            break
    message = command.message if controller.is_over else f"{controller.phase}: {cause}"
    return builder.finish(controller, scene, world, message)


def _names(collision: LinkCollision) -> tuple[str, str]:
    """Return the names of both bodies of a collision."""
    return collision.first, collision.second
