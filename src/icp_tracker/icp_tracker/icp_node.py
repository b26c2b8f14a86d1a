"""The node: centerline, voxels and contour rays of the hull in; everybody's reference points and fits out.

One message a set holds everybody: the filter knows from it who is there, and waits for nobody else.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON, PART_NAMES, Fit
from mocap_packets.hull import NO_CONTOUR_RAYS, NO_VOXELS, Centerline, ContourRays, HullProducts, VoxelSamples
from mocap_packets.people import PeoplePoints, Predictions, format_bodies
from mocap_packets.stamp_order import Order, StampOrder
from sagoma_ros.health import OK, WARN
from sagoma_ros.intra_process import Delivery, LazyPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.joint_motion import read_predictions
from sagoma_ros.messages import key_values, to_stamp
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import Text, people_cloud, read_finite
from sagoma_ros.process import run_node
from sagoma_ros.qos import LATCHED
from sagoma_ros.silence import SilenceWatch
from sagoma_ros.worker import Mailbox, Worker
from stick_figure.body import Body
from stick_figure.body_file import format_body

from .icp_ros import FilterFeedback, SaveBodyService, SavedBody
from .people.people_tracker import PeopleTracker, make_people_tracker
from .settings import IcpNodeSettings
from .tracker import ACQUIRING, TRACKING, warm_up

CLOUDS_KEPT = 4
TOLD_EVERY_S = 1.0  # a reason why nobody is found yet: people read, and reasons may change with every set
T = TypeVar("T", Centerline, VoxelSamples, ContourRays)


class IcpNode(SagomaNode):
    """Fits a stick figure a person to every centerline, in stamp order, on a thread of its own."""

    Settings = IcpNodeSettings

    def __init__(self, name: str = "icp_tracker", **options: object) -> None:
        super().__init__(name, **options)
        self._tracker: PeopleTracker | None = None
        self._worker: Worker[Delivery[Centerline]] | None = None
        self._subscriptions_held: list[PacketSubscription] = []
        self._publishers_held: list[PacketPublisher | LazyPublisher] = []
        self._lock = threading.Lock()  # tracker and stamps: worker against ~/reset
        self._order = StampOrder()
        self._told: dict[int, str] = {}
        self._told_s: dict[int, float] = {}  # when, by the steady clock
        self._published: dict[int, Body] = {}
        self._silence: SilenceWatch | None = None

    # --- lifecycle -----------------------------------------------------------------------------------------------

    def configure(self) -> None:
        settings: IcpNodeSettings = self.settings
        self._tracker = make_people_tracker(settings)
        warm_up(settings)
        self._points_publisher = PacketPublisher[PeoplePoints](self, PointCloud2, "icp/reference_points", people_cloud)
        self._fit_publisher = LazyPublisher(self, DiagnosticArray, "icp/fit")
        self._body_publisher = PacketPublisher[Text](self, String, "icp/body", Text.to_message, LATCHED)
        self._bodies_publisher = PacketPublisher[Text](self, String, "icp/bodies", Text.to_message, LATCHED)
        self._publishers_held = [
            *(self._points_publisher, self._fit_publisher, self._body_publisher, self._bodies_publisher)
        ]
        self._reset_service = self.create_service(Trigger, "~/reset", self._on_reset)
        self._save_body = SaveBodyService(self, settings.bodies)

    def activate(self) -> None:
        settings: IcpNodeSettings = self.settings
        self._feedback = FilterFeedback(settings.prediction_wait_s)
        kept = settings.queue_depth + CLOUDS_KEPT  # those of every set that waits, and of the next ones
        self._voxels: Mailbox[Delivery[VoxelSamples]] = Mailbox(kept, settings.voxels_wait_s)
        self._contour_rays: Mailbox[Delivery[ContourRays]] = Mailbox(kept, settings.voxels_wait_s)
        self._order.reset()
        self._silence = SilenceWatch(self, settings.stale_after_s, self._on_silence)
        self._worker = Worker(
            "icp",
            self._process,
            settings.queue_depth,
            on_drop=lambda: self.health.count("dropped_sets"),
            on_error=self._on_error,
        )
        self._subscriptions_held = [
            PacketSubscription(self, PointCloud2, "hull/centerline", self._on_centerline),
            PacketSubscription(self, PointCloud2, "hull/voxels", self._on_voxels),
            PacketSubscription(self, PointCloud2, "hull/contour_rays", self._on_contour_rays),
            PacketSubscription(self, MultiDOFJointState, "ekf/prediction", self._on_prediction),
        ]

    def deactivate(self) -> None:
        for subscription in self._subscriptions_held:
            subscription.close()
        self._subscriptions_held = []
        if self._silence is not None:
            self._silence.close()
        if self._worker is not None:
            self._feedback.mailbox.close()
            self._voxels.close()
            self._contour_rays.close()
            self._worker.close()
            self._worker = None

    def cleanup(self) -> None:
        for publisher in self._publishers_held:
            publisher.close()
        if self._publishers_held:
            self.destroy_service(self._reset_service)
            self._save_body.close()
        self._publishers_held = []
        self._published = {}
        self._tracker = None

    # --- callbacks -----------------------------------------------------------------------------------------------

    def _on_centerline(self, line: Delivery[Centerline]) -> None:
        if self._worker is not None and self._silence is not None:
            self._silence.heard()
            self._worker.put(line)

    def _on_voxels(self, voxels: Delivery[VoxelSamples]) -> None:
        if self._tracker is not None and self._tracker.needs_voxels:
            self._voxels.put(voxels.stamp_ns, voxels)

    def _on_contour_rays(self, rays: Delivery[ContourRays]) -> None:
        if self._tracker is not None and self._tracker.needs_contour_rays:
            self._contour_rays.put(rays.stamp_ns, rays)

    def _on_prediction(self, prediction: Delivery[Predictions]) -> None:
        if prediction.packet is not None:
            self._feedback.put(prediction.packet.as_sent())
            return
        try:
            self._feedback.put(read_predictions(prediction.message, self.resolve_topic_name("ekf/prediction")))
        except InputError as error:
            self._refuse("bad_predictions", error)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._begin_anew()
            self._order.reset()
        response.success = True
        response.message = f"looking for the first pose again ({self.settings.initial_pose.source})"
        return response

    def _begin_anew(self) -> None:
        """Forget everybody; the lock is held."""
        if self._tracker is not None:
            self._tracker.reset()
        self._save_body.forget()
        self._told = {}

    def _on_silence(self, silent_s: float) -> None:
        """Report that no frame sets come; a fit that comes reports for itself."""
        self.health.status(WARN, f"no frame sets for {silent_s:.0f} s: do the hull server and the cameras run?")

    # --- one frame set, on the worker's thread -------------------------------------------------------------------

    def _process(self, centerline: Delivery[Centerline]) -> None:
        stamp_ns = centerline.stamp_ns
        if not self._in_order(stamp_ns):
            return
        line = self._read(centerline, Centerline, "centerline")
        seen = HullProducts(stamp_ns, line, self._voxels_of(stamp_ns), self._contour_rays_of(stamp_ns))
        predictions = self._feedback.after_previous_set()
        with self._lock:
            if self._tracker is None:
                return
            began = time.perf_counter()
            fits = self._tracker.step(seen, predictions)
            bodies = {fit.person: body for fit in fits if (body := self._tracker.body_of(fit.person)) is not None}
            acquiring = self._tracker.acquiring
            self.health.set("fit_ms", 1e3 * (time.perf_counter() - began))
        self._feedback.asked(stamp_ns)
        self._publish_bodies(stamp_ns, bodies)
        self._publish(fits, acquiring, centerline.frame_id)

    def _in_order(self, stamp_ns: int) -> bool:
        """Return whether a set is to be fitted; stamps that went back begin anew, which is said once."""
        with self._lock:
            before_ns = self._order.last_ns or 0
            order = self._order.take(stamp_ns, time.monotonic_ns() if self.settings.stale_after_s > 0 else None)
            if order is Order.RESTART:
                self._begin_anew()
                self._feedback.forget()
        if order is Order.PAST:
            self.health.count("backward_stamps")
        elif order is Order.AHEAD:
            self.health.count("ahead_stamps")
        elif order is Order.RESTART:
            self.health.count("restarts")
            back_s = 1e-9 * (before_ns - stamp_ns)
            self.get_logger().warning(f"stamps went back by {back_s:.3f} s: a new beginning, for everybody")
        return order in (Order.NEXT, Order.RESTART)

    def _voxels_of(self, stamp_ns: int) -> VoxelSamples:
        """Return the set's voxels, if they are wanted and there."""
        if self._tracker is None or not self._tracker.needs_voxels:
            return NO_VOXELS
        voxels = self._voxels.take(stamp_ns)
        if voxels is None:
            self.health.count("sets_without_voxels")
            return NO_VOXELS
        return self._read(voxels, VoxelSamples, "voxels")

    def _contour_rays_of(self, stamp_ns: int) -> ContourRays:
        """Return the set's contour rays, if they are wanted and there."""
        if self._tracker is None or not self._tracker.needs_contour_rays:
            return NO_CONTOUR_RAYS
        rays = self._contour_rays.take(stamp_ns)
        if rays is None:
            self.health.count("sets_without_contour_rays")
            return NO_CONTOUR_RAYS
        return self._read(rays, ContourRays, "contour_rays")

    def _read(self, delivery: Delivery[T], kind: type[T], name: str) -> T:
        """A packet as it was sent; of a cloud, its rows of finite numbers, none when it is damaged: the set still gets
        its answer, so that nobody waits for it."""
        if delivery.packet is not None:
            return delivery.packet.as_sent()
        try:
            packet, dropped = read_finite(delivery.message, kind, self.resolve_topic_name(f"hull/{name}"))
        except InputError as error:
            self._refuse(f"bad_{name}", error)
            return kind.from_table(np.empty(0, kind.LAYOUT))
        if dropped:
            self.health.count("dropped_points" if name == "centerline" else f"dropped_{name}", dropped)
        return packet

    def _publish_bodies(self, stamp_ns: int, bodies: dict[int, Body]) -> None:
        """Bodies as latched YAML, before the first points that were fitted with them: the filter takes the same."""
        changed = [person for person, body in bodies.items() if body is not self._published.get(person)]
        self._published = self._published | bodies
        for person in changed:
            self._save_body.keep(person, SavedBody(stamp_ns, bodies[person]))
        if FIRST_PERSON in changed:
            self._body_publisher.publish(Text(format_body(bodies[FIRST_PERSON], source="icp_tracker")), stamp_ns, "")
        if set(changed) - {FIRST_PERSON}:
            others = {person: body for person, body in self._published.items() if person != FIRST_PERSON}
            self._bodies_publisher.publish(Text(format_bodies(others, source="icp_tracker")), stamp_ns, "")

    def _publish(self, fits: tuple[Fit, ...], acquiring: tuple[str, ...], frame_id: str) -> None:
        stamp_ns = fits[0].stamp_ns
        self._points_publisher.publish(PeoplePoints.of_fits(fits), stamp_ns, frame_id)
        self._fit_publisher.publish(fit_message, fits, self.settings.method)
        self.health.tick(stamp_ns)
        self.health.set("late_predictions", self._feedback.mailbox.timeouts)
        good = not acquiring and all(fit.state == TRACKING for fit in fits)
        self.health.status(OK if good else WARN, summary_of(fits, acquiring))
        for fit in fits:
            self._tell(fit)

    def _tell(self, fit: Fit) -> None:
        """Log how it stands with a person, whenever that has changed."""
        who = "" if fit.person == FIRST_PERSON else f"person {fit.person}: "
        # while looking for a first pose every new reason tells the person what to do; later ones hold changing figures
        told = _state_of(fit) if fit.state == ACQUIRING else fit.state
        now_s = time.monotonic()
        too_soon = fit.state == ACQUIRING and now_s - self._told_s.get(fit.person, -TOLD_EVERY_S) < TOLD_EVERY_S
        if told != self._told.get(fit.person) and not too_soon:
            self._told[fit.person], self._told_s[fit.person] = told, now_s
            self.get_logger().info(f"{who}{_state_of(fit)}")
        if fit.recovered:
            self.health.count("recoveries")
            self.get_logger().info(f"{who}found again: {fit.recovered}")

    def _refuse(self, counter: str, error: InputError) -> None:
        self.health.count(counter)
        self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def _on_error(self, error: Exception) -> None:
        self.health.count("failed_sets")
        self.get_logger().error(f"a frame set failed: {error!r}", throttle_duration_sec=5.0)


def summary_of(fits: tuple[Fit, ...], acquiring: tuple[str, ...] = ()) -> str:
    """Return in one line how it stands with everybody: of one person alone state and reason; ``acquiring`` : why each
    body that is nobody's yet has no first pose."""
    if len(fits) == 1 and not acquiring:
        return _state_of(fits[0])
    people = [f"{fit.person} {fit.state}" + (f" ({fit.reason})" if fit.reason else "") for fit in fits]
    others = [f"another acquiring ({reason})" for reason in acquiring]
    return f"{len(fits) + len(acquiring)} persons: {', '.join([*people, *others])}"


def _state_of(fit: Fit) -> str:
    return f"{fit.state}: {fit.reason}" if fit.reason else fit.state


def fit_message(fits: tuple[Fit, ...], method: str) -> DiagnosticArray:
    """Return how the fits of one set went, for icp/fit: one status a person, the first person's first.

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
