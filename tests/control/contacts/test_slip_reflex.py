"""The reflex on slip: at once, growing while slip lasts, decaying afterwards; and friction bounds in each step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import disturbed, pose_at_rest, settings_with, state_at_rest, with_contacts

from graspforce import ContactSet, InvalidInput
from graspforce.contact import friction
from graspforce.control import Command, ControlMemory, ObjectController
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.contacts.slip_reflex import LARGEST_SQUEEZE, RISE_TIME, ReflexMemory, SlipReflex
from graspforce.core.arrays import Array
from graspforce.core.errors import UnknownName
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")

ROUNDING = 1e-6  # N: the certificate's tolerance of 1e-8 is relative to some newtons
GRASPS = ["allegro_right sphere", "four_finger box", "dlr_hit2 sphere"]
SQUEEZE = 0.3


def resting_step(controller: ObjectController, **conditions: object) -> Command:
    """Return the next command at rest."""
    return controller.step(state_at_rest(controller.grasp), pose_at_rest(controller.grasp), **conditions)


def used_friction(command: Command, margin: float = 0.3, reserve: float = 0.1) -> Array:
    """Return the friction that the planned forces need with margin and reserve, (N,)."""
    contacts = command.contacts
    padded = contacts.pad(command.f)
    required = friction.required_friction(padded, contacts.mu, contacts.gamma)  # N
    return (required + margin) / ((1.0 - reserve) * padded[:, friction.F_N])


def make_grasp(name: str) -> Grasp:
    if name == "soft":
        return with_contacts(named_grasp("four_finger box"), model="soft", torsional_friction=0.005)
    return named_grasp(name)


@pytest.mark.parametrize("name", [*GRASPS, "soft"])
def test_slipping_contact_is_squeezed_in_the_same_period(name: str) -> None:
    """The contact needs a friction that is 1 + g times smaller, and the forces still supply the wrench."""
    grasp = make_grasp(name)
    count = len(grasp.contacts)
    for slipping in (*np.eye(count, dtype=bool), np.ones(count, dtype=bool)):
        controller = ObjectController(grasp, settings_with(reflex_squeeze=SQUEEZE))
        before = resting_step(controller)
        after = resting_step(controller, slipping=slipping)
        names = [name for name, slips in zip(grasp.fingers, slipping, strict=True) if slips]
        assert [text.split(" slips: ")[0] for text in after.warnings] == names
        assert after.solution.found
        squeezed = used_friction(before)[slipping] / (1.0 + SQUEEZE)
        assert (used_friction(after)[slipping] <= squeezed * (1.0 + 1e-5)).all()
        if slipping.all():
            f_n = grasp.contacts.normal_rows
            assert after.f[f_n].sum() > 1.15 * before.f[f_n].sum()
        np.testing.assert_allclose(after.w, before.w, atol=1e-9)


def test_reflex_decays_with_its_time_constant() -> None:
    """Without slip the level falls by e in the reflex time, and the forces return to those of the model."""
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp, settings_with(reflex_squeeze=SQUEEZE, reflex_time=0.2))
    modelled = resting_step(controller)
    resting_step(controller, slipping=[True] * 4)
    first = controller.memory.reflex.level
    assert (first >= SQUEEZE - 1e-6).all()  # more where a contact used less than all of its friction
    for k in range(1, 2001):
        command = resting_step(controller)
        if k in (1, 100, 200, 600):
            level = first * np.exp(-k * 1e-3 / 0.2)
            np.testing.assert_allclose(controller.memory.reflex.level, level, rtol=1e-9)
            assert (used_friction(command) <= 0.7 / (1.0 + level) * (1.0 + 1e-6)).all()
    assert controller.memory.reflex is None  # exp(−10) is negligible
    np.testing.assert_allclose(command.f, modelled.f, atol=1e-4)


def test_squeeze_grows_while_slip_lasts_to_a_bound() -> None:
    grasp = named_grasp("four_finger box")
    settings = settings_with(reflex_squeeze=SQUEEZE)
    reflex, mu = SlipReflex(grasp.contacts, settings, 0.3), grasp.contacts.mu
    slipping = np.array([True, False, True, False])
    memory = reflex.step(None, slipping, mu, None)
    np.testing.assert_allclose(memory.level, [SQUEEZE, 0.0, SQUEEZE, 0.0])
    steps = round(RISE_TIME / settings.period)
    for _ in range(steps):
        memory = reflex.step(memory, slipping, mu, None)
    np.testing.assert_allclose(1.0 + memory.level[::2], (1.0 + SQUEEZE) ** 2)
    for _ in range(20 * steps):
        memory = reflex.step(memory, slipping, mu, None)
    np.testing.assert_allclose(1.0 + memory.level, [LARGEST_SQUEEZE, 1.0, LARGEST_SQUEEZE, 1.0])


def test_second_slip_squeezes_from_the_force_of_the_last_step() -> None:
    """A slip in the middle of the decay raises the normal forces of that moment by 1 + g, or keeps a larger level."""
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp, settings_with(reflex_squeeze=SQUEEZE, reflex_time=0.1))
    resting_step(controller)
    resting_step(controller, slipping=[True] * 4)
    for _ in range(100):
        before = resting_step(controller)
    after = resting_step(controller, slipping=[True] * 4)
    np.testing.assert_allclose(used_friction(after), used_friction(before) / (1.0 + SQUEEZE), rtol=1e-6)


@pytest.mark.parametrize("name", GRASPS)
def test_forces_keep_within_the_friction_of_the_step(name: str) -> None:
    """Bounds below and above the modelled friction; without bounds the model counts again."""
    grasp, rng = named_grasp(name), np.random.default_rng(86)
    settings = settings_with(friction_reserve=0.0, force_weight=0.0)
    controller = ObjectController(grasp, settings)
    state, desired = disturbed(grasp, 2)
    modelled = controller.step(state, desired)
    for _ in range(5):
        mu = grasp.contacts.mu * rng.uniform(0.6, 1.4, len(grasp.contacts))
        controller.reset()
        command = controller.step(state, desired, friction=mu)
        assert not any("margin" in warning for warning in command.warnings)
        margins = friction.slip_margin(command.contacts.pad(command.f), mu, grasp.contacts.gamma)
        assert margins.min() >= 0.3 - ROUNDING
        # the same as a controller of a grasp with that friction
        other = with_friction(grasp, mu.tolist())
        new = ObjectController(other, settings).step(state, desired)
        assert command.solution.objective == pytest.approx(new.solution.objective, rel=1e-6)
    controller.reset()
    np.testing.assert_array_equal(controller.step(state, desired).f, modelled.f)


def with_friction(grasp: Grasp, mu: list[float]) -> Grasp:
    """Return the grasp with another friction coefficient for each contact."""
    contacts = [replace(contact, friction=value) for contact, value in zip(grasp.contacts.contacts, mu, strict=True)]
    return replace(grasp, contacts=ContactSet.stack(contacts))


def test_step_without_slip_is_bit_identical() -> None:
    grasp = named_grasp("allegro_right sphere")
    plain, asked = (ObjectController(grasp, settings_with()) for _ in range(2))
    for seed in range(5):
        one, other = plain.step(*disturbed(grasp, seed)), asked.step(*disturbed(grasp, seed), slipping=[False] * 3)
        assert np.array_equal(one.f, other.f)
        assert np.array_equal(one.tau, other.tau)


def test_reflex_is_saved_with_the_memory() -> None:
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp, settings_with())
    resting_step(controller, slipping=[True, False, False, False])
    memory = ControlMemory.from_dict(controller.memory.to_dict(), grasp.contacts)
    assert np.array_equal(memory.reflex.level, controller.memory.reflex.level)
    assert np.array_equal(memory.reflex.slipping, [True, False, False, False])
    with pytest.raises(InvalidInput, match=r"memory.reflex.level"):
        ControlMemory.from_dict({**memory.to_dict(), "reflex": {"level": [1.0], "slipping": [True]}}, grasp.contacts)
    with pytest.raises(InvalidInput, match=r"reflex.slipping\[0\] = 1"):
        ReflexMemory.from_dict({"level": [1.0], "slipping": [1]}, 1)


def test_conditions_are_read_as_written_and_checked() -> None:
    grasp = named_grasp("four_finger box")
    for conditions in (
        ContactConditions(),
        ContactConditions([True, False, False, True], [0.1, 0.2, 0.3, 0.4], ["finger_2"], [True, True, False, True]),
    ):
        again = ContactConditions.from_dict(conditions.to_dict())
        assert again.to_dict() == conditions.to_dict()
        again.check(grasp)
    for change, field in (
        ({"slipping": [1, 0, 0, 0]}, "slipping"),
        ({"touching": [1, 0, 0, 0]}, "touching"),
        ({"friction": [-0.1] * 4}, r"friction\[0\]"),
        ({"lost": "finger_1"}, "lost"),
        ({"lost": [1]}, r"lost\[0\]"),
    ):
        with pytest.raises(InvalidInput, match=field):
            ContactConditions(**change)
        with pytest.raises(InvalidInput, match=f"conditions.{field}"):
            ContactConditions.from_dict(change)
    for conditions in (ContactConditions([True]), ContactConditions(friction=[0.5] * 3), ContactConditions(touching=[True])):
        with pytest.raises(InvalidInput, match="a list of 4, one for each contact"):
            conditions.check(grasp)
    with pytest.raises(UnknownName, match="thumb"):
        ContactConditions(lost=["thumb"]).check(grasp)
