"""The lifecycle node that all nodes of the graph derive from, and its parameters; their common main is in `process`.

configure / activate / deactivate / cleanup are the thesis's connect / start / suspend / stop (6.2). Parameters come
from a settings class: declared with description and range, read back typed; unknown ones are refused.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service

from capture_rig.errors import InputError
from capture_rig.settings import Leaf, build_settings, leaves, setting

from .health import ERROR, OK, NodeHealth
from .middleware import resolve_packages

T = TypeVar("T")

RCLError = rclpy_implementation.RCLError
TAKES_EFFECT = "takes effect at the next configure: deactivate, cleanup, configure and activate the node"
FOREIGN_PREFIXES = ("qos_overrides.",)  # declared by rclpy when a topic is made, possibly later than we look


@dataclass(frozen=True)
class CommonSettings:
    """The parameters that every node has."""

    autostart: bool = setting(False, "configure and activate by itself, without a supervisor")
    tf_prefix: str = setting(
        "", "begins every frame and every REP-155 id: another one for each graph of a domain", is_name=True
    )


class SagomaNode(LifecycleNode):
    """A lifecycle node with typed settings, diagnostics, and errors that a user can act on.

    A subclass names its settings class in ``Settings`` and fills four hooks: ``configure`` (``self.settings`` is
    ready), ``activate``, ``deactivate``, ``cleanup``. An InputError in a hook is logged as one clear line, shown in
    the diagnostics, and fails the transition; after a failed ``configure``, ``cleanup`` is called, after a failed
    ``activate``, ``deactivate``. Both are called at shutdown too, whatever the state, so they must be idempotent.
    """

    Settings: ClassVar[type]

    def __init__(self, name: str, **options: Any) -> None:
        self._in_use = False  # configured with the settings
        super().__init__(name, **options)
        declare_parameters(self, self.Settings)
        declare_parameters(self, CommonSettings)
        self.settings: Any = None
        self.tf_prefix = ""
        self.health = NodeHealth(self)
        self.health.status(OK, "unconfigured")
        self.on_active: Callable[[], object] = lambda: None
        """What the process does each time the node has become active."""

    def configure(self) -> None:
        """Connect: open the files and connections of the settings."""

    def activate(self) -> None:
        """Start."""

    def deactivate(self) -> None:
        """Suspend."""

    def cleanup(self) -> None:
        """Stop: release everything."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        def configure() -> None:
            self.settings = read_parameters(self, self.Settings)
            self.tf_prefix = read_declared(self, CommonSettings).tf_prefix
            if hasattr(self.settings, "frame_id"):  # of the world; those of cameras and bodies have other names
                self.settings = replace(self.settings, frame_id=self.tf_prefix + self.settings.frame_id)
            self.configure()

        result = self._attempt(configure, "configured, inactive")
        self._in_use = result == TransitionCallbackReturn.SUCCESS
        if result != TransitionCallbackReturn.SUCCESS:
            self._attempt(self.cleanup, None)
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_activate(state)
        result = self._attempt(self.activate, "active")
        if result != TransitionCallbackReturn.SUCCESS:
            self._attempt(self.deactivate, None)
            super().on_deactivate(state)
        else:
            self.on_active()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._attempt(self.deactivate, "suspended")
        if result == TransitionCallbackReturn.SUCCESS:
            super().on_deactivate(state)
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._in_use = False
        return self._attempt(self.cleanup, "unconfigured")

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._stop()

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._attempt(self.cleanup, None)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters as every node does; while it is configured, the result says when a change takes effect."""
        result = super().set_parameters_atomically(parameter_list)
        settings = {leaf.key for leaf in (*leaves(self.Settings), *leaves(CommonSettings))}
        changed = ", ".join(parameter.name for parameter in parameter_list if parameter.name in settings)
        if result.successful and changed and self._in_use:
            result.reason = TAKES_EFFECT
            self.get_logger().info(f"{changed}: {TAKES_EFFECT}")
        return result

    def close(self) -> None:
        """Release everything before the process ends, in whatever state the node is."""
        self._stop()

    def report(self, error: Exception) -> None:
        """Log an unexpected error with its traceback, count it, and show it in the diagnostics."""
        self.get_logger().error("".join(traceback.format_exception(error)))
        self.health.count("unexpected_errors")
        self.health.status(ERROR, repr(error))

    def create_service(self, *args: Any, **options: Any) -> Service:
        """Create a service as every node does; the callback may be a coroutine function under any executor."""
        service = super().create_service(*args, **options)
        if inspect.iscoroutinefunction(service.callback):
            send = partial(self._respond, service.send_response)  # EventsExecutor awaits no callback
            service.send_response = send  # type: ignore[method-assign]
        return service

    def _respond(self, send: Callable[[Any, Any], None], response: Any, header: Any) -> None:
        """Send a response now, or that of a coroutine when it is done."""
        if not inspect.iscoroutine(response):
            return send(response, header)

        async def respond() -> None:
            try:
                send(await response, header)
            except Exception as error:
                self.report(error)

        assert self.executor is not None
        self.executor.create_task(respond)

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        # rclpy raises here when the present state has no such transition: the process would end, the caller wait
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
        except RCLError:
            asked = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {asked!r} is not possible in the present state")
            response.success = False
            return response

    def _stop(self) -> TransitionCallbackReturn:
        self._attempt(self.deactivate, None)
        return self._attempt(self.cleanup, None)

    def _attempt(self, hook: Callable[[], None], done: str | None) -> TransitionCallbackReturn:
        try:
            hook()
        except InputError as error:
            self.get_logger().error(str(error))
            self.health.status(ERROR, str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # a defect of ours: log where, and leave the node usable
            self.report(error)
            return TransitionCallbackReturn.FAILURE
        if done is not None:
            self.health.status(OK, done)
        return TransitionCallbackReturn.SUCCESS


# --- parameters -----------------------------------------------------------------------------------------------------


def declare_parameters(node: Node, settings_class: type) -> None:
    """Declare every setting as a parameter; later changes are checked, and take effect at the next configure."""
    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    known = {leaf.key: leaf for leaf in leaves(settings_class)}
    for key, leaf in known.items():
        value = _of_type(leaf, given.get(key, leaf.default))
        node.declare_parameter(key, value, _descriptor(leaf), ignore_override=True)
    node.add_pre_set_parameters_callback(lambda changes: [_change_of_type(known, change) for change in changes])
    node.add_on_set_parameters_callback(lambda changes: _check(node, settings_class, changes))
    _describe_ranges(node, known)


def _of_type(leaf: Leaf, value: Any) -> Any:
    """Return the value, an int for a float parameter as a float, so that the parameter keeps its type."""
    if leaf.type is float and type(value) is int:
        return float(value)
    if leaf.type == list[float] and isinstance(value, Sequence) and any(type(one) is int for one in value):
        return [float(one) if type(one) is int else one for one in value]
    return value


def _change_of_type(known: Mapping[str, Leaf], change: Parameter) -> Parameter:
    value = _of_type(known[change.name], change.value) if change.name in known else change.value
    return change if value is change.value else Parameter(change.name, value=value)


def _describe_ranges(node: Node, known: Mapping[str, Leaf]) -> None:
    """Let the node report ranges of parameters, which rqt uses for its sliders.

    rclpy does not get them: it would refuse values without saying what to do, and bad overrides with an exception.
    """
    described = node.describe_parameter

    def describe(name: str) -> ParameterDescriptor:
        found, leaf = described(name), known.get(name)
        if leaf is None:
            return found
        found = copy(found)
        found.dynamic_typing = False  # another type is refused, by our own check
        low, high = leaf.bounds
        if leaf.type is float and leaf.has_range:
            found.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        elif leaf.type is int and leaf.has_range:
            found.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        return found

    node.describe_parameter = describe  # type: ignore[method-assign]


def read_parameters(node: Node, settings_class: type[T]) -> T:
    """Return the declared parameters as an instance of ``settings_class``.

    Raises InputError naming node, key, value and remedy: unknown parameter, wrong type, out of range.
    """
    return build_settings(
        settings_class, _declared(node, settings_class) | _undeclared(node, settings_class), _where(node)
    )


def read_declared(node: Node, settings_class: type[T]) -> T:
    """Return the same as :func:`read_parameters`; parameters that ``settings_class`` does not know are ignored."""
    return build_settings(settings_class, _declared(node, settings_class), _where(node))


def _declared(node: Node, settings_class: type) -> dict[str, Any]:
    declared = {leaf.key: _value(leaf, node.get_parameter(leaf.key).value) for leaf in leaves(settings_class)}
    return {key: resolve_packages(value) for key, value in declared.items()}


def _value(leaf: Leaf, given: Any) -> Any:
    # an empty list in a parameter file has no type, and arrives as no value at all
    return [] if given is None and isinstance(leaf.default, list) else given


def _undeclared(node: Node, settings_class: type) -> dict[str, Any]:
    # overrides of parameters that nobody declared are silently ignored by rclpy: a misspelt key would go unnoticed
    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    return {k: v for k, v in given.items() if not node.has_parameter(k) and not k.startswith(FOREIGN_PREFIXES)}


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
    constraints = ""
    if choices:
        constraints = "one of " + ", ".join(map(str, choices))
    elif leaf.has_range:
        constraints = leaf.range_text
    return ParameterDescriptor(
        description=leaf.metadata.get("help", "") + (f" [{unit}]" if unit else ""),
        additional_constraints=constraints,
        dynamic_typing=True,
    )
