"""ROS parameters from a settings class: declared with description and range, read back typed, unknown ones refused."""

from __future__ import annotations

from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from capture_rig.errors import InputError
from capture_rig.settings import Leaf, build_settings, leaves

T = TypeVar("T")

FOREIGN_PREFIXES = ("qos_overrides.",)  # declared by rclpy when a topic is made, possibly later than we look


def declare_parameters(node: Node, settings_class: type) -> None:
    """Declare every setting as a parameter; later changes are checked, and take effect at the next configure."""
    for leaf in leaves(settings_class):
        node.declare_parameter(leaf.key, leaf.default, _descriptor(leaf))
    node.add_on_set_parameters_callback(lambda changes: _check(node, settings_class, changes))


def read_parameters(node: Node, settings_class: type[T]) -> T:
    """The declared parameters as an instance of ``settings_class``.

    Raises InputError naming node, key, value and remedy: unknown parameter, wrong type, out of range.
    """
    return build_settings(settings_class, _declared(node, settings_class) | _undeclared(node), _where(node))


def read_declared(node: Node, settings_class: type[T]) -> T:
    """As :func:`read_parameters`, but parameters that ``settings_class`` does not know are none of its business."""
    return build_settings(settings_class, _declared(node, settings_class), _where(node))


def _declared(node: Node, settings_class: type) -> dict[str, Any]:
    return {leaf.key: _value(leaf, node.get_parameter(leaf.key).value) for leaf in leaves(settings_class)}


def _value(leaf: Leaf, given: Any) -> Any:
    # an empty list in a parameter file has no type, and arrives as no value at all
    return [] if given is None and isinstance(leaf.default, list) else given


def _undeclared(node: Node) -> dict[str, Any]:
    # overrides of parameters that nobody declared are silently ignored by rclpy: a misspelt key would go unnoticed
    given = node._parameter_overrides.items()
    return {k: v.value for k, v in given if not node.has_parameter(k) and not k.startswith(FOREIGN_PREFIXES)}


def _where(node: Node) -> str:
    return f"parameters of {node.get_fully_qualified_name()}"


def _check(node: Node, settings_class: type, changes: list[Parameter]) -> SetParametersResult:
    known = {leaf.key: leaf for leaf in leaves(settings_class)}
    values = {change.name: _value(known[change.name], change.value) for change in changes if change.name in known}
    try:
        build_settings(settings_class, values, _where(node))
    except InputError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def _descriptor(leaf: Leaf) -> ParameterDescriptor:
    """Description, unit and allowed values. Type and range are left to our own check, whose error names the remedy."""
    unit, choices = leaf.metadata.get("unit"), leaf.metadata.get("choices")
    low, high = leaf.metadata.get("low"), leaf.metadata.get("high")
    constraints = ""
    if choices:
        constraints = "one of " + ", ".join(map(str, choices))
    elif low is not None or high is not None:
        constraints = f"{'-inf' if low is None else low} to {'inf' if high is None else high}"
    return ParameterDescriptor(
        description=leaf.metadata.get("help", "") + (f" [{unit}]" if unit else ""),
        additional_constraints=constraints,
        dynamic_typing=True,
    )
