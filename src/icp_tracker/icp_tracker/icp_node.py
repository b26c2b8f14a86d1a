"""The node: hull products in, everybody's fits out, in one packet a set."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from mocap_packets.fit import FIRST_PERSON, PART_NAMES, Fit
from mocap_packets.hull import HullProducts
from mocap_packets.people import FittedPeople, PeoplePoints, Predictions, format_bodies
from sagoma_ros.health import LOG_EVERY_S, OK, PERIOD_S, WARN
from sagoma_ros.inputs import InputWatchdog, StampOrder, Worker
from sagoma_ros.intra_process import Delivery, LazyPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.messages import key_values, to_stamp
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import FITTED_PEOPLE, HULL_PRODUCTS, PREDICTIONS, people_cloud
from sagoma_ros.process import run_node
from sagoma_ros.qos import LATCHED
from stick_figure.body import Body, format_body

from .extrinsic_monitor import ExtrinsicErrors
from .icp_ros import FilterFeedback, KeypointInputs, SaveBodyService
from .people.people_tracker import PeopleTracker, make_people_tracker
from .settings import IcpNodeSettings
from .tracker import ACQUIRING, TRACKING, warm_up


class IcpNode(SagomaNode):
    """Fits a stick figure a person to every hull, in stamp order, on a thread of its own."""

    Settings = IcpNodeSettings

    def __init__(self, name: str = "icp_tracker", **options: object) -> None:
        super().__init__(name, **options)
        self._tracker: PeopleTracker | None = None
        self._worker: Worker[Delivery[HullProducts]] | None = None
        self._subscriptions_held: list[PacketSubscription] = []
        self._closing: list[Callable[[], object]] = []  # releases what configure has opened
        self._lock = threading.Lock()  # tracker and stamps: worker against ~/reset
        self._order = StampOrder(self, self._restart)
        self._logged: dict[int, tuple[str, float]] = {}  # of each person, and when, by the steady clock
        self._published: dict[int, Body] = {}
        self._watchdog: InputWatchdog | None = None
        self._rig: Rig | None = None
        self._errors = ExtrinsicErrors()
        self._keypoints: KeypointInputs | None = None  # of the cameras of a rig that is known
        self.health.describe(self._describe)

    # --- lifecycle -----------------------------------------------------------------------------------------------

    def configure(self) -> None:
        settings: IcpNodeSettings = self.settings
        self._tracker = make_people_tracker(settings)
        self._rig = load_rig(settings.initial_pose.rig_file) if settings.initial_pose.rig_file else None
        warm_up(settings)
        self._people_publisher = PacketPublisher(self, FITTED_PEOPLE)
        self._points_publisher = LazyPublisher(self, PointCloud2, "icp/reference_points")
        self._fit_publisher = LazyPublisher(self, DiagnosticArray, "icp/fit")
        self._body_publisher = LazyPublisher(self, String, "icp/body", LATCHED)
        self._bodies_publisher = LazyPublisher(self, String, "icp/bodies", LATCHED)
        publishers = (self._points_publisher, self._fit_publisher, self._body_publisher, self._bodies_publisher)
        self._closing += [self._people_publisher.close, *(publisher.close for publisher in publishers)]
        self._closing.append(partial(self.destroy_service, self.create_service(Trigger, "~/reset", self._on_reset)))
        self._save_body = SaveBodyService(self, settings.bodies)
        self._closing.append(self._save_body.close)

    def activate(self) -> None:
        settings: IcpNodeSettings = self.settings
        self._feedback = FilterFeedback(settings.prediction_wait_s)
        self._order.reset()
        if self._rig is not None:
            self._keypoints = KeypointInputs(self, self._rig, settings.keypoints_wait_s, settings.stale_after_s)
        self._watchdog = InputWatchdog(self, settings.stale_after_s, self._on_silence)
        self._worker = Worker(
            "icp",
            self._process,
            settings.queue_depth,
            on_drop=lambda: self.health.count("dropped_sets"),
            on_error=self._on_error,
        )
        self._subscriptions_held = [
            PacketSubscription(self, HULL_PRODUCTS, self._on_hull),
            PacketSubscription(self, PREDICTIONS, self._on_prediction),
        ]

    def deactivate(self) -> None:
        for subscription in self._subscriptions_held:
            subscription.close()
        self._subscriptions_held = []
        if self._watchdog is not None:
            self._watchdog.close()
        if self._keypoints is not None:
            self._keypoints.close()
        if self._worker is not None:
            self._feedback.close()
            self._worker.close()
            self._worker = None

    def cleanup(self) -> None:
        for close in self._closing:
            close()
        self._closing = []
        self._published = {}
        self._tracker = None

    # --- callbacks -----------------------------------------------------------------------------------------------

    def _on_hull(self, products: Delivery[HullProducts]) -> None:
        if self._worker is not None and self._watchdog is not None:
            self._watchdog.reset()
            self._worker.put(products)

    def _on_prediction(self, predictions: Delivery[Predictions]) -> None:
        try:
            self._feedback.update(predictions.packet)
        except InputError as error:
            self._drop("bad_predictions", error)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._forget_people()
            self._order.reset()
        response.success = True
        response.message = f"looking for the first pose again ({self.settings.initial_pose.source})"
        return response

    def _restart(self) -> None:
        """Reset when stamps have gone back; the lock is held."""
        self._forget_people()
        self._feedback.forget()
        if self._keypoints is not None:
            self._keypoints.forget()

    def _forget_people(self) -> None:
        if self._tracker is not None:
            self._tracker.reset()
        self._save_body.forget()
        self._logged = {}

    def _on_silence(self, silent_s: float) -> None:
        """Report that no frame sets come."""
        self.health.status(WARN, f"no frame sets for {silent_s:.0f} s: do the hull server and the cameras run?")

    # --- one frame set, on the worker's thread -------------------------------------------------------------------

    def _process(self, delivery: Delivery[HullProducts]) -> None:
        try:
            seen = delivery.packet
        except InputError as error:
            self._drop("bad_hulls", error)
            return
        with self._lock:
            if not self._order.admits(seen.stamp_ns):
                return
        if self._keypoints is not None:
            seen = replace(seen, keypoints=self._keypoints.of_set(seen.stamp_ns))
            self.health.set("keypoints", len(seen.keypoints.score))
        predictions = self._feedback.after_previous_set()
        with self._lock:
            if self._tracker is None:
                return
            began = time.perf_counter()
            fits = self._tracker.step(seen, predictions)
            bodies = {fit.person: body for fit in fits if (body := self._tracker.body_of(fit.person)) is not None}
            acquiring, errors = self._tracker.acquiring, self._tracker.extrinsic_errors
            self.health.set("fit_ms", 1e3 * (time.perf_counter() - began))
        people = FittedPeople(seen.stamp_ns, PeoplePoints.of_fits(fits), bodies, seen.ages)
        self._publish_bodies(people.stamp_ns, bodies)
        self._feedback.sent(people.stamp_ns)
        self._people_publisher.publish(people, delivery.frame_id)
        self._points_publisher.publish(people_cloud, people.points, people.stamp_ns, delivery.frame_id)
        self._report_cameras(errors)
        self._publish(fits, acquiring)

    def _publish_bodies(self, stamp_ns: int, bodies: dict[int, Body]) -> None:
        """Publish the bodies that have changed, as latched YAML, before the first points that were fitted with them."""
        changed = [person for person, body in bodies.items() if body is not self._published.get(person)]
        self._published = self._published | bodies
        for person in changed:
            self._save_body.keep(person, stamp_ns, bodies[person])
        if FIRST_PERSON in changed:
            text = format_body(bodies[FIRST_PERSON], source="icp_tracker")
            self._body_publisher.publish(lambda: String(data=text))
        if set(changed) - {FIRST_PERSON}:
            others = {person: body for person, body in self._published.items() if person != FIRST_PERSON}
            self._bodies_publisher.publish(lambda: String(data=format_bodies(others, source="icp_tracker")))

    def _publish(self, fits: tuple[Fit, ...], acquiring: tuple[str, ...]) -> None:
        """Publish and log the state of the fits."""
        self._fit_publisher.publish(fit_message, fits, self.settings.method)
        self.health.tick(fits[0].stamp_ns)
        self.health.set("late_predictions", self._feedback.timeouts)
        good = not acquiring and all(fit.state == TRACKING for fit in fits)
        troubles = tuple(dict.fromkeys(self._errors.suspects.values()))
        level = OK if good and not troubles else WARN
        self.health.status(level, "; ".join([summary_of(fits, acquiring), *troubles]))
        for fit in fits:
            self._log_state(fit)

    def _report_cameras(self, errors: ExtrinsicErrors) -> None:
        """Keep the cameras' calibration errors; log newly suspected cameras."""
        if errors is self._errors:
            return
        new = {*errors.suspects} - {*self._errors.suspects}
        for text in dict.fromkeys(text for camera, text in errors.suspects.items() if camera in new):
            self.get_logger().warning(text)
        self._errors = errors

    def _describe(self) -> Mapping[str, object]:
        """Return the cameras' calibration errors for the diagnostics."""
        shifts = " ".join(f"{name}={1e3 * m:.1f}" for name, m in self._errors.shift_m.items())
        return {"calibration_suspects": ",".join(self._errors.suspects), "calibration_shift_mm": shifts}

    def _log_state(self, fit: Fit) -> None:
        """Log a person's state when it has changed, once in PERIOD_S at most."""
        who = "" if fit.person == FIRST_PERSON else f"person {fit.person}: "
        # before the first pose every new reason is an instruction to the person; later ones hold changing figures
        state = _state_of(fit) if fit.state == ACQUIRING else fit.state
        now_s = time.monotonic()
        logged, logged_s = self._logged.get(fit.person, ("", now_s - PERIOD_S))
        if fit.recovered:
            self.health.count("recoveries")
        if (state != logged or fit.recovered) and now_s - logged_s >= PERIOD_S:
            self._logged[fit.person] = state, now_s
            found = f"; found again: {fit.recovered}" if fit.recovered else ""
            self.get_logger().info(f"{who}{_state_of(fit)}{found}")

    def _drop(self, counter: str, error: InputError) -> None:
        self.health.count(counter)
        self.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)

    def _on_error(self, error: Exception) -> None:
        self.health.count("failed_sets")
        self.get_logger().error(f"a frame set failed: {error!r}", throttle_duration_sec=LOG_EVERY_S)


def summary_of(fits: tuple[Fit, ...], acquiring: tuple[str, ...] = ()) -> str:
    """Return everybody's state in one line, of one person alone with the reason; ``acquiring`` : why each newcomer has
    no first pose yet."""
    if len(fits) == 1 and not acquiring:
        return _state_of(fits[0])
    people = [f"{fit.person} {fit.state}" + (f" ({fit.reason})" if fit.reason else "") for fit in fits]
    others = [f"another acquiring ({reason})" for reason in acquiring]
    return f"{len(fits) + len(acquiring)} persons: {', '.join([*people, *others])}"


def _state_of(fit: Fit) -> str:
    return f"{fit.state}: {fit.reason}" if fit.reason else fit.state


def fit_message(fits: tuple[Fit, ...], method: str) -> DiagnosticArray:
    """Return the message of icp/fit for the fits of one set: one status a person, the first person's first.

    Holds no clock times, so equal inputs give equal bytes.
    """
    message = DiagnosticArray(status=[_fit_status(fit, method) for fit in fits])
    message.header.stamp = to_stamp(fits[0].stamp_ns)
    return message


def _fit_status(fit: Fit, method: str) -> DiagnosticStatus:
    values: dict[str, object] = {"state": fit.state, "method": method, "started_from": fit.started_from}
    if fit.solution is not None:
        values |= {
            "rms_mm": f"{1e3 * fit.solution.rms_m:.3f}",
            "points": fit.solution.points,
            "inliers": fit.solution.inliers,
            "iterations": fit.solution.iterations,
            "converged": fit.solution.converged,
        }
    values |= {"visible": int(fit.visible.sum()), "dropped_points": fit.dropped_points}
    if fit.solution is not None:
        quality = fit.quality
        values |= {"explained": f"{quality.explained:.3f}", "recovered": fit.recovered}
        values |= dict(zip(PART_NAMES, quality.parts, strict=True))
        if quality.hypothesis_margin is not None:
            values["hypothesis_margin"] = f"{quality.hypothesis_margin:.1f}"
    trusted = fit.solution is not None and fit.state == TRACKING
    person = "" if fit.person == FIRST_PERSON else f" of person {fit.person}"
    return DiagnosticStatus(
        level=DiagnosticStatus.OK if trusted else DiagnosticStatus.WARN,
        name=f"icp_tracker: fit{person}",
        message=fit.reason or "fitted",
        values=key_values(values),
    )


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable icp_tracker."""
    sys.exit(run_node(IcpNode, args))


if __name__ == "__main__":
    main()
