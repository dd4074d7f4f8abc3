"""Parameters of a node, as ``ros2 param`` reads and sets them: numbers that may be changed while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from graspforce.core.errors import GraspForceError
from graspforce.service.ros2.interfaces import make
from graspforce.service.ros2.node import Node

NOT_SET, INTEGER, DOUBLE = 0, 2, 3
"""Types of values, as in ``rcl_interfaces/msg/ParameterType``."""

_MSG, _SRV = "rcl_interfaces/msg", "rcl_interfaces/srv"


class NumberParameter(NamedTuple):
    """A parameter that is a number.

    Attributes:
        description: its meaning and its unit.
        get: function that returns its value.
        set: function that sets its value; an error of graspforce refuses it.
    """

    description: str
    get: Callable[[], float]
    set: Callable[[float], None]


class ParameterServer:
    """The services of a node's parameters.

    Args:
        node: the node.
        parameters: the parameters by name.
    """

    def __init__(self, node: Node, parameters: Mapping[str, NumberParameter]) -> None:
        self._parameters = dict(parameters)
        node.serve("~/get_parameters", f"{_SRV}/GetParameters", self._get)
        node.serve("~/get_parameter_types", f"{_SRV}/GetParameterTypes", self._types)
        node.serve("~/set_parameters", f"{_SRV}/SetParameters", self._set)
        node.serve("~/set_parameters_atomically", f"{_SRV}/SetParametersAtomically", self._set_all)
        node.serve("~/list_parameters", f"{_SRV}/ListParameters", self._list)
        node.serve("~/describe_parameters", f"{_SRV}/DescribeParameters", self._describe)

    def _get(self, request: Any) -> Any:
        """Return the values of parameters; those that do not exist are not set."""
        known = self._parameters
        values = [make_value(known[name].get() if name in known else None) for name in request.names]
        return make(f"{_SRV}/GetParameters_Response", values=values)

    def _types(self, request: Any) -> Any:
        """Return the types of parameters."""
        types = [DOUBLE if name in self._parameters else NOT_SET for name in request.names]
        return make(f"{_SRV}/GetParameterTypes_Response", types=np.array(types, dtype=np.uint8))

    def _set(self, request: Any) -> Any:
        """Set parameters, each on its own."""
        results = [self._set_one(parameter) for parameter in request.parameters]
        return make(f"{_SRV}/SetParameters_Response", results=results)

    def _set_all(self, request: Any) -> Any:
        """Set all parameters, or none if one is refused."""
        known, result = self._parameters, _result("")
        names = [parameter.name for parameter in request.parameters]
        before = {name: known[name].get() for name in names if name in known}
        for parameter in request.parameters:
            result = self._set_one(parameter)
            if not result.successful:
                for name, value in before.items():
                    known[name].set(value)
                break
        return make(f"{_SRV}/SetParametersAtomically_Response", result=result)

    def _set_one(self, parameter: Any) -> Any:
        """Set a parameter, and return the result."""
        name, value = parameter.name, parameter.value
        if name not in self._parameters:
            return _result(f"no parameter {name}: those of the node are {', '.join(self._parameters)}")
        if value.type not in (INTEGER, DOUBLE):
            return _result(f"{name} must be a number")
        try:
            self._parameters[name].set(float(value.double_value if value.type == DOUBLE else value.integer_value))
        except GraspForceError as error:
            return _result(str(error))
        return _result("")

    def _list(self, request: Any) -> Any:
        """Return the names of the parameters that begin with a prefix; without prefixes, of all."""
        prefixes = list(request.prefixes)
        names = [name for name in self._parameters if not prefixes or name in prefixes]
        result = make(f"{_MSG}/ListParametersResult", names=names, prefixes=[])
        return make(f"{_SRV}/ListParameters_Response", result=result)

    def _describe(self, request: Any) -> Any:
        """Return the descriptions of parameters."""
        found = [self._descriptor(name) for name in request.names]
        return make(f"{_SRV}/DescribeParameters_Response", descriptors=found)

    def _descriptor(self, name: str) -> Any:
        """Return the description of a parameter; that of one that does not exist has no type."""
        known = self._parameters.get(name)
        return make(
            f"{_MSG}/ParameterDescriptor",
            name=name,
            type=NOT_SET if known is None else DOUBLE,
            description="" if known is None else known.description,
            additional_constraints="",
            read_only=False,
            dynamic_typing=False,
            floating_point_range=[],
            integer_range=[],
        )


def make_value(value: float | None) -> Any:
    """Return the message of a value.

    Args:
        value: the number; None for a value that is not set.
    """
    none = {name: np.zeros(0, dtype=kind) for name, kind in _ARRAYS.items()}
    return make(
        f"{_MSG}/ParameterValue",
        type=NOT_SET if value is None else DOUBLE,
        bool_value=False,
        integer_value=0,
        double_value=0.0 if value is None else value,
        string_value="",
        string_array_value=[],
        **none,
    )


_ARRAYS: dict[str, Any] = {
    "byte_array_value": np.uint8,
    "bool_array_value": np.bool_,
    "integer_array_value": np.int64,
    "double_array_value": np.float64,
}


def _result(reason: str) -> Any:
    """Return the result of setting a parameter: refused if there is a reason."""
    return make(f"{_MSG}/SetParametersResult", successful=not reason, reason=reason)
