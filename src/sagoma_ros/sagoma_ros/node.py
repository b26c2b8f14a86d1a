"""The lifecycle node that all nodes of the graph derive from.

configure / activate / deactivate / cleanup are the thesis's connect / start / suspend / stop (6.2).
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from capture_rig.errors import InputError
from capture_rig.settings import setting

from .health import ERROR, OK, NodeHealth
from .parameters import declare_parameters, read_declared, read_parameters

RCLError = rclpy_implementation.RCLError


@dataclass(frozen=True)
class Autonomy:
    """The parameter that every node has."""

    autostart: bool = setting(False, "configure and activate by itself, without a supervisor")


class SagomaNode(LifecycleNode):
    """A lifecycle node with typed settings, diagnostics, and errors that a user can act on.

    A subclass names its settings class in ``Settings`` and fills four hooks: ``configure`` (``self.settings`` is
    ready), ``activate``, ``deactivate``, ``cleanup``. An InputError in a hook is logged as one clear line, shown in
    the diagnostics, and fails the transition; after a failed ``configure``, ``cleanup`` is called, after a failed
    ``activate``, ``deactivate``. Both are called at shutdown too, whatever the state, so they must be idempotent.
    """

    Settings: ClassVar[type]

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        declare_parameters(self, self.Settings)
        declare_parameters(self, Autonomy)
        self.settings: Any = None
        self.health = NodeHealth(self, hardware_id=name)
        self.health.status(OK, "unconfigured")

    def configure(self) -> None:
        """Connect: open what the settings name."""

    def activate(self) -> None:
        """Start."""

    def deactivate(self) -> None:
        """Suspend."""

    def cleanup(self) -> None:
        """Stop: release everything."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        def configure() -> None:
            self.settings = read_parameters(self, self.Settings)
            self.configure()

        result = self._attempt(configure, "configured, inactive")
        if result != TransitionCallbackReturn.SUCCESS:
            self._attempt(self.cleanup, None)
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_activate(state)
        result = self._attempt(self.activate, "active")
        if result != TransitionCallbackReturn.SUCCESS:
            self._attempt(self.deactivate, None)
            super().on_deactivate(state)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._attempt(self.deactivate, "suspended")
        if result == TransitionCallbackReturn.SUCCESS:
            super().on_deactivate(state)
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._attempt(self.cleanup, "unconfigured")

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._stop()

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._attempt(self.cleanup, None)

    def autostart(self) -> bool:
        """Configure and activate by oneself when the parameter ``autostart`` says so; False when that failed."""
        if not read_declared(self, Autonomy).autostart:
            return True
        steps = (self.trigger_configure, self.trigger_activate)
        return all(step() == TransitionCallbackReturn.SUCCESS for step in steps)

    def close(self) -> None:
        """Release everything before the process ends, in whatever state the node is."""
        self._stop()

    def report(self, error: Exception) -> None:
        """Log an unexpected error with its traceback, count it, and show it in the diagnostics."""
        self.get_logger().error("".join(traceback.format_exception(error)))
        self.health.count("unexpected_errors")
        self.health.status(ERROR, repr(error))

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
        except Exception as error:  # a defect of ours: say where, and leave the node usable
            self.report(error)
            return TransitionCallbackReturn.FAILURE
        if done is not None:
            self.health.status(OK, done)
        return TransitionCallbackReturn.SUCCESS
