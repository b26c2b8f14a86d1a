"""Asks the running nodes for their parameters, so that a bag can say what made it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from .service_calls import call_all


def read_configuration(node: Node, names: Sequence[str], timeout_s: float) -> dict[str, dict[str, Any]]:
    """Full node name -> its parameters; a node that does not answer in time is left out.

    ``node`` must be spun by another thread.
    """
    questions = {f"{name}/list_parameters": ListParameters.Request() for name in names}
    listed = call_all(node, ListParameters, questions, timeout_s)
    keys = {n: list(reply.result.names) for n in names if (reply := listed[f"{n}/list_parameters"]) is not None}
    requests = {f"{name}/get_parameters": GetParameters.Request(names=keys[name]) for name in keys}
    replies = call_all(node, GetParameters, requests, timeout_s)
    return {
        name: {key: _plain(value) for key, value in zip(keys[name], reply.values, strict=True)}
        for name in keys
        if (reply := replies[f"{name}/get_parameters"]) is not None
    }


def _plain(value: Any) -> Any:
    found = parameter_value_to_python(value)
    return found if found is None or isinstance(found, bool | int | float | str) else list(found)
