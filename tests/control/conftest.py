"""Fixture that runs a test of the control law with the C code and without it."""

from __future__ import annotations

import pytest

from graspforce.contact import compiled_kinematics
from graspforce.control import grasp_friction, object_control_law
from graspforce.control.contacts import mobility


@pytest.fixture(params=["compiled", "python"])
def arithmetic(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the test twice: with the C code, and with the reference in Python."""
    if request.param == "python":
        for module in (object_control_law, compiled_kinematics, mobility, grasp_friction):
            monkeypatch.setattr(module, "native", None)
    elif object_control_law.native is None:
        pytest.skip("the C code was not built: no C compiler at installation")
