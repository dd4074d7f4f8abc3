"""Parameters of a node, as ``ros2 param`` asks for them, without a network: requests and responses after their encoding."""

from __future__ import annotations

import numpy as np
import pytest
from support.ros2_messages import carried
from zenoh_ros2_sdk.utils import compute_service_type_hash

from graspforce.core.errors import InvalidInput
from graspforce.service.ros2 import interfaces
from graspforce.service.ros2.parameters import DOUBLE, INTEGER, NOT_SET, NumberParameter, ParameterServer, make_value

SRV, MSG = "rcl_interfaces/srv", "rcl_interfaces/msg"


class RecordedNode:
    """A node that keeps the functions of its services, and calls them with encoded requests."""

    def __init__(self):
        self.services = {}

    def serve(self, name, type_name, answer):
        self.services[name.removeprefix("~/")] = (type_name, answer)

    def ask(self, name, **fields):
        type_name, answer = self.services[name]
        request = carried(f"{type_name}_Request", interfaces.make(f"{type_name}_Request", **fields))
        return carried(f"{type_name}_Response", answer(request))


@pytest.fixture
def values():
    return {"slip_margin": 0.5, "rate": 500.0}


@pytest.fixture
def node(values):
    def setter(name):
        def set_value(value):
            if value < 0.0:
                raise InvalidInput(name, value, "at least 0")
            values[name] = value

        return set_value

    made = RecordedNode()
    ParameterServer(
        made, {name: NumberParameter(f"{name}, N", lambda name=name: values[name], setter(name)) for name in values}
    )
    return made


def parameter(name, value, kind=DOUBLE):
    """Return a message with a parameter."""
    message = make_value(float(value))
    message.type = kind
    if kind == INTEGER:
        message.integer_value, message.double_value = int(value), 0.0
    return interfaces.make(f"{MSG}/Parameter", name=name, value=message)


def test_parameters_are_listed_described_and_read(node):
    assert node.ask("list_parameters", prefixes=[], depth=0).result.names == ["slip_margin", "rate"]
    assert node.ask("list_parameters", prefixes=["rate"], depth=0).result.names == ["rate"]
    known, unknown = node.ask("describe_parameters", names=["slip_margin", "colour"]).descriptors
    assert (known.name, known.type, known.description) == ("slip_margin", DOUBLE, "slip_margin, N")
    assert (unknown.name, unknown.type) == ("colour", NOT_SET)
    assert node.ask("get_parameter_types", names=["colour", "rate"]).types.tolist() == [NOT_SET, DOUBLE]
    found, missing = node.ask("get_parameters", names=["slip_margin", "colour"]).values
    assert (found.type, found.double_value, missing.type) == (DOUBLE, 0.5, NOT_SET)


def test_parameters_are_set_each_on_its_own(node, values):
    given = [parameter("slip_margin", 0.8), parameter("rate", -1.0), parameter("colour", 1.0), parameter("rate", 200, INTEGER)]
    results = node.ask("set_parameters", parameters=given).results
    assert [each.successful for each in results] == [True, False, False, True]
    assert "at least 0" in results[1].reason
    assert "slip_margin, rate" in results[2].reason
    assert values == {"slip_margin": 0.8, "rate": 200.0}
    [text] = node.ask("set_parameters", parameters=[parameter("rate", 1.0, kind=4)]).results
    assert text.reason == "rate must be a number"


def test_parameters_set_together_stay_if_one_is_refused(node, values):
    given = [parameter("slip_margin", 0.8), parameter("rate", -1.0)]
    assert not node.ask("set_parameters_atomically", parameters=given).result.successful
    assert values == {"slip_margin": 0.5, "rate": 500.0}
    given[1] = parameter("rate", 250.0)
    assert node.ask("set_parameters_atomically", parameters=given).result.successful
    assert values == {"slip_margin": 0.8, "rate": 250.0}


def test_hashes_are_those_of_the_peer():
    expected = compute_service_type_hash(f"{SRV}/GetParameterTypes", "string[] names", "uint8[] types")
    assert interfaces.type_hash(f"{SRV}/GetParameterTypes") == expected
    assert np.unique([interfaces.type_hash(f"{SRV}/{name}Parameters") for name in ("Get", "Set", "List", "Describe")]).size == 4
