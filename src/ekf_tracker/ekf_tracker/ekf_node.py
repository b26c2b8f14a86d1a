"""The EKF as a lifecycle node: everybody's measured points in, everybody's state out, one answer to every frame set."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from time import monotonic_ns

from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON, NOTHING_SEEN, ReferencePoints
from mocap_packets.people import PeoplePoints, Predictions, parse_bodies
from mocap_packets.stamp_order import Order, StampOrder
from mocap_packets.state import BodyState, NoState, Tracking
from sagoma_ros.health import ERROR, OK, WARN
from sagoma_ros.intra_process import Delivery, PacketPublisher, PacketSubscription
from sagoma_ros.joint_motion import predictions_message
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import Text, read_people_points
from sagoma_ros.process import run_node
from sagoma_ros.qos import LATCHED, RESULT
from sagoma_ros.silence import SilenceWatch
from stick_figure.body import Body
from stick_figure.body_file import load_body, parse_body

from .filter import warm_up
from .frames_ros import BodyFrames
from .humans_ros import Humans, NoHumans, make_humans
from .latency_ros import LatencyReport
from .measurement import Measurement
from .people import PeopleFilter
from .people_ros import Answer, PeopleTopics, is_tracked
from .settings import EkfNodeSettings
from .track import POINT_SD_FLOOR_M

POINTS_TOPIC, BODY_TOPIC, BODIES_TOPIC = "icp/reference_points", "icp/body", "icp/bodies"
HEALTH = {Tracking.ACQUIRING: WARN, Tracking.TRACKING: OK, Tracking.DOUBTFUL: WARN, Tracking.LOST: ERROR}
NOBODY_SEEN = PeoplePoints({FIRST_PERSON: NOTHING_SEEN})


class EkfNode(SagomaNode):
    """icp/reference_points (and bodies) to mocap/*; ekf/prediction is published last, once for every set."""

    Settings = EkfNodeSettings

    def __init__(self, **options: object) -> None:
        super().__init__("ekf_tracker", **options)
        self._closing: list[Callable[[], object]] = []  # releases what configure has opened
        self._answering = threading.RLock()  # points may come on the tracker's thread, body and requests on ours
        self._humans: Humans = NoHumans()
        self._filters = PeopleFilter()
        self._order = StampOrder()
        self._silence: SilenceWatch | None = None
        self._active = False

    def configure(self) -> None:
        """Load the body if a file names it, compile the filter, open topics."""
        settings: EkfNodeSettings = self.settings
        self._waiting: deque[tuple[int, PeoplePoints, int]] = deque()
        self._texts: dict[str, str] = {}
        self._bodies: dict[int, Body] = {}
        self._given = load_body(settings.body_file) if settings.body_file else None
        self._filters = PeopleFilter(settings.filter)
        warm_up()
        self._topics = PeopleTopics(self, settings, self._forget)
        self._closing.append(self._topics.close)
        self._humans = make_humans(self, settings.publish_humans, self._topics.id_of(FIRST_PERSON), settings.frame_id)
        self._frames = BodyFrames(self, settings.publish_tf, settings.frame_id)
        self._closing.append(self._frames.close)
        self._prediction = PacketPublisher[Predictions](self, MultiDOFJointState, "ekf/prediction", predictions_message)
        self._closing.append(self._prediction.close)
        self._latency = LatencyReport(self)
        self._closing.append(self._latency.close)
        service = self.create_service(Trigger, "~/reset", self._on_reset)
        wall_time = Clock(clock_type=ClockType.STEADY_TIME)  # a person waits, whatever time the sets are of
        wait_s = max(settings.body_wait_s, 1e-3)
        self._body_timeout = self.create_timer(wait_s, self._answer_waiting, clock=wall_time, autostart=False)
        self._closing += [partial(self.destroy_service, service), partial(self.destroy_timer, self._body_timeout)]
        if self._given is None:
            for topic, take in ((BODY_TOPIC, self._on_body), (BODIES_TOPIC, self._on_bodies)):
                self._closing.append(PacketSubscription(self, String, topic, take, LATCHED).close)
        self._closing.append(PacketSubscription(self, PointCloud2, POINTS_TOPIC, self._on_points).close)

    def activate(self) -> None:
        """Answer sets from now on."""
        with self._answering:
            self._active = True
        self._silence = SilenceWatch(self, self.settings.stale_after_s, self._on_silence)

    def deactivate(self) -> None:
        """Ignore sets from now on; the state is kept."""
        if self._silence is not None:
            self._silence.close()
        with self._answering:
            self._active = False

    def cleanup(self) -> None:
        """Close topics, forget bodies and states."""
        for close in self._closing:
            close()
        self._closing.clear()
        with self._answering:
            self._humans.close()
            self._humans, self._filters = NoHumans(), PeopleFilter()
            self._order.reset()

    def _on_body(self, delivery: Delivery[Text]) -> None:
        self._take_bodies(delivery, BODY_TOPIC, lambda text, where: {FIRST_PERSON: parse_body(text, where)})

    def _on_bodies(self, delivery: Delivery[Text]) -> None:
        self._take_bodies(delivery, BODIES_TOPIC, parse_bodies)

    def _take_bodies(self, delivery: Delivery[Text], topic: str, parse: Callable[[str, str], dict[int, Body]]) -> None:
        text = (delivery.packet or delivery.message).data
        with self._answering:
            if text == self._texts.get(topic):
                return
            try:
                bodies = parse(text, topic)
            except InputError as error:
                self._drop("bad_body", error)
                return
            self._texts[topic] = text
            self._bodies |= bodies
            if FIRST_PERSON in bodies:
                self._filters.follow(FIRST_PERSON, bodies[FIRST_PERSON])
            statures = [f"{body.stature:.2f} m" for body in bodies.values()]
            self.get_logger().info(f"{topic}: stature {', '.join(statures)}")
            while self._waiting and not self._waits_for_a_body(self._waiting[0][1]):
                self._answer(*self._waiting.popleft())

    def _body_of(self, person: int) -> Body | None:
        return self._bodies.get(person, self._given)

    def _on_points(self, points: Delivery[PeoplePoints]) -> None:
        with self._answering:
            if self._active and self._silence is not None:
                self._silence.heard()
                self._take(points.stamp_ns, self._read(points), self._latency.now_ns())

    def _take(self, stamp_ns: int, measured: PeoplePoints, fitted_ns: int) -> None:
        if self._waiting or self._waits_for_a_body(measured):
            self._waiting.append((stamp_ns, measured, fitted_ns))
            if len(self._waiting) > RESULT.depth:
                self._answer(*self._waiting.popleft())
            self._body_timeout.reset()
            return
        self._answer(stamp_ns, measured, fitted_ns)

    def _waits_for_a_body(self, measured: PeoplePoints) -> bool:
        """Return whether somebody is seen whose body was measured with this set, and will come."""
        return any(points.visible.any() and self._body_of(person) is None for person, points in measured.of.items())

    def _answer_waiting(self) -> None:
        with self._answering:
            self._body_timeout.cancel()
            while self._waiting:
                self._answer(*self._waiting.popleft())

    def _read(self, delivery: Delivery[PeoplePoints]) -> PeoplePoints:
        """Everybody's points, covariances, visibility; of a cloud that cannot be used, that nothing was seen."""
        try:
            if delivery.frame_id != self.settings.frame_id:
                remedy = f"Publish in '{self.settings.frame_id}', or set the parameter frame_id."
                raise InputError(f"frame_id is '{delivery.frame_id}'", where=POINTS_TOPIC, remedy=remedy)
            if delivery.packet is not None:
                return delivery.packet.as_sent()
            return read_people_points(delivery.message, POINTS_TOPIC)
        except InputError as error:
            self._drop("bad_points", error)
            return NOBODY_SEEN

    def _answer(self, stamp_ns: int, measured: PeoplePoints, fitted_ns: int) -> None:
        """Publish the one answer that every set gets: everybody's."""
        if self._is_left_out(stamp_ns):
            answers: dict[int, Answer] = {FIRST_PERSON: NoState(stamp_ns, "stamp is out of order")}
            self._topics.say_of_first(answers[FIRST_PERSON])
        else:
            answers = self._filtered(stamp_ns, measured)
            self._publish(answers, stamp_ns)
        predictions = Predictions(stamp_ns, {person: answer.prediction for person, answer in answers.items()})
        self._prediction.publish(predictions, stamp_ns, self.settings.frame_id)
        self._latency.answered(stamp_ns, fitted_ns)
        self.health.status(max(HEALTH[answer.tracking] for answer in answers.values()), summary_of(answers))
        self.health.tick(stamp_ns)

    def _publish(self, answers: dict[int, Answer], stamp_ns: int) -> None:
        bodies = {person: body for person in answers if (body := self._body_of(person)) is not None}
        self._topics.publish_bodies(answers, bodies)
        tracked = {p: (a, bodies[p]) for p, a in answers.items() if isinstance(a, BodyState) and is_tracked(a)}
        by_id = {self._topics.id_of(p): body for p, body in tracked.items()}
        self._frames.update(by_id)
        self._humans.update(by_id, stamp_ns)
        self._topics.publish_states(answers, stamp_ns)

    def _is_left_out(self, stamp_ns: int) -> bool:
        """Return whether a set comes too late, or far ahead; stamps that went back begin anew, which is said once."""
        before_ns = self._order.last_ns or 0
        order = self._order.take(stamp_ns, monotonic_ns() if self.settings.stale_after_s > 0 else None)
        if order is Order.PAST:
            what, remedy = f"stamp {stamp_ns} ns is of the past", "Send each frame set once, in stamp order."
            self._drop("stamp_back", InputError(what, where=POINTS_TOPIC, remedy=remedy))
        elif order is Order.AHEAD:
            what, remedy = f"stamp {stamp_ns} ns is far ahead of the sets before", "Check the clocks of the cameras."
            self._drop("stamp_ahead", InputError(what, where=POINTS_TOPIC, remedy=remedy))
        elif order is Order.RESTART:
            self.health.count("restarts")
            back_s = 1e-9 * (before_ns - stamp_ns)
            self.get_logger().warning(f"stamps went back by {back_s:.3f} s: a new beginning, for everybody")
            self._forget_states()
            self._latency.forget()
        return order in (Order.PAST, Order.AHEAD)

    def _filtered(self, stamp_ns: int, measured: PeoplePoints) -> dict[int, Answer]:
        """Let everybody's filter answer a set."""
        for person in measured.of:
            if (body := self._body_of(person)) is not None:
                self._filters.follow(person, body)
            else:
                self.health.count("without_body")
        try:
            # one of several may be refused when others have been filtered already, so theirs are looked at before
            alone = len(measured.of) == 1
            usable = measured.of if alone else {p: self._usable(points) for p, points in measured.of.items()}
            return self._filters.step(stamp_ns, usable)
        except InputError as error:
            self._drop("bad_points", error)
            return self._filters.step(stamp_ns, dict.fromkeys(measured.of, NOTHING_SEEN))

    def _usable(self, points: ReferencePoints) -> ReferencePoints:
        """Return the points, or that nothing was seen where the filter would refuse them."""
        try:
            Measurement.checked(points.points_world, points.covariance, points.visible, POINT_SD_FLOOR_M)
        except InputError as error:
            self._drop("bad_points", error)
            return NOTHING_SEEN
        return points

    def _on_silence(self, silent_s: float) -> None:
        with self._answering:
            if not self._active:
                return
            reason = f"no frame sets for {silent_s:.0f} s"
            state = self._topics.be_silent(reason)
            self._humans.update({}, self.get_clock().now().nanoseconds)
            self.health.status(HEALTH[state], f"{state}: {reason}")

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._start_anew()
        response.success, response.message = True, "everybody's next set with a visible torso starts anew"
        return response

    def _start_anew(self) -> None:
        with self._answering:
            self._order.reset()
            self._forget_states()

    def _forget_states(self) -> None:
        self._filters.reset()
        self._topics.clear()

    def _forget(self, body_id: str) -> None:
        self._humans.forget(body_id)

    def _drop(self, counter: str, error: InputError) -> None:
        self.health.count(counter)
        self.get_logger().warning(str(error), throttle_duration_sec=5.0)


def summary_of(answers: dict[int, Answer]) -> str:
    """Return in one line how it stands with everybody: of one person alone state and reason, of several why not."""
    if len(answers) == 1:
        (answer,) = answers.values()
        return f"{answer.tracking}: {answer.reason}"
    people = [
        f"{p} {a.tracking}" if a.tracking == Tracking.TRACKING else f"{p} {a.tracking} ({a.reason})"
        for p, a in answers.items()
    ]
    return f"{len(answers)} persons: {', '.join(people)}"


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``ekf_tracker``."""
    sys.exit(run_node(EkfNode, args))


if __name__ == "__main__":
    main()
