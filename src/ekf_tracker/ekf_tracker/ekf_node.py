"""The EKF as a lifecycle node: everybody's measured points in, everybody's state out, one answer to every frame set."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON, NOTHING_SEEN
from mocap_packets.people import AnsweredSet, FittedPeople, PeoplePoints, Predictions
from mocap_packets.state import BodyState, Tracking
from mocap_packets.table import NO_AGES
from sagoma_ros.health import LOG_EVERY_S
from sagoma_ros.inputs import InputWatchdog, StampOrder
from sagoma_ros.intra_process import Delivery, PacketPublisher, PacketSubscription
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import FITTED_PEOPLE, LATENCY, PREDICTIONS
from sagoma_ros.process import run_node

from .filter import PeopleFilter, warm_up
from .humans_ros import BodyFrames, HumansPublisher, Tracked
from .people_ros import LEVELS, Answer, PeopleTopics
from .settings import LINK_FRAMES, NO_FRAMES, EkfNodeSettings


class EkfNode(SagomaNode):
    """icp/people to mocap/* and ekf/prediction; mocap/latency is published last, once for every set."""

    Settings = EkfNodeSettings

    def __init__(self, **options: object) -> None:
        super().__init__("ekf_tracker", **options)
        self._closing: list[Callable[[], object]] = []  # releases what configure has opened
        self._answering = threading.RLock()  # fits may come on the tracker's thread, requests on ours
        self._bodies: list[BodyFrames | HumansPublisher] = []
        self._filters = PeopleFilter()
        self._order = StampOrder(self, lambda: self._filters.reset())
        self._watchdog: InputWatchdog | None = None
        self._active = False

    def configure(self) -> None:
        """Compile the filter, open topics."""
        settings: EkfNodeSettings = self.settings
        self._filters = PeopleFilter(settings.filter)
        warm_up()
        self._topics = PeopleTopics(self, settings, self.tf_prefix, self._forget)
        self._closing.append(self._topics.close)
        if settings.publish_humans:
            self._bodies.append(HumansPublisher(self, self._topics.id_of(FIRST_PERSON), settings.frame_id))
        if settings.publish_tf != NO_FRAMES:
            self._bodies.append(BodyFrames(self, settings.publish_tf == LINK_FRAMES, settings.frame_id))
        self._prediction = PacketPublisher(self, PREDICTIONS)
        self._latency = PacketPublisher(self, LATENCY)
        self._closing += [self._prediction.close, self._latency.close]
        service = self.create_service(Trigger, "~/reset", self._on_reset)
        self._closing.append(partial(self.destroy_service, service))
        self._closing.append(PacketSubscription(self, FITTED_PEOPLE, self._on_people).close)

    def activate(self) -> None:
        """Answer sets from now on."""
        with self._answering:
            self._active = True
        self._watchdog = InputWatchdog(self, self.settings.stale_after_s, self._on_silence)

    def deactivate(self) -> None:
        """Ignore sets from now on; the state is kept."""
        if self._watchdog is not None:
            self._watchdog.close()
        with self._answering:
            self._active = False

    def cleanup(self) -> None:
        """Close topics, forget states."""
        for close in self._closing:
            close()
        self._closing.clear()
        with self._answering:
            for bodies in self._bodies:
                bodies.close()
            self._bodies, self._filters = [], PeopleFilter()
            self._order.reset()

    def _on_people(self, delivery: Delivery[FittedPeople]) -> None:
        with self._answering:
            if not self._active or self._watchdog is None:
                return
            self._watchdog.reset()
            fitted_ns = self._now_ns()
            try:
                people = delivery.packet
                if delivery.frame_id != self.settings.frame_id:
                    remedy = f"Publish in '{self.settings.frame_id}', or set the parameter frame_id."
                    raise InputError(f"frame_id is '{delivery.frame_id}'", where=FITTED_PEOPLE.name, remedy=remedy)
            except InputError as error:
                self._drop(error)
                return
            if self._order.admits(people.stamp_ns):
                self._answer(people, fitted_ns)

    def _answer(self, people: FittedPeople, fitted_ns: int) -> None:
        """Publish the one answer that every set gets: everybody's."""
        stamp_ns, answers = people.stamp_ns, self._filtered(people)
        self._publish(answers, stamp_ns)
        predictions = Predictions(stamp_ns, {person: answer.prediction for person, answer in answers.items()})
        self._prediction.publish(predictions, self.settings.frame_id)
        ages = replace(people.ages, fitted=fitted_ns - stamp_ns, published=self._now_ns() - stamp_ns)
        self._latency.publish(AnsweredSet(stamp_ns, ages if people.ages.hull else NO_AGES), self.settings.frame_id)
        self.health.status(max(LEVELS[answer.tracking] for answer in answers.values()), summary_of(answers))
        self.health.tick(stamp_ns)

    def _now_ns(self) -> int:
        """Return the time by the clock of stamps."""
        return self.get_clock().now().nanoseconds

    def _publish(self, answers: dict[int, Answer], stamp_ns: int) -> None:
        bodies = self._filters.bodies
        tracked = {
            person: (answer, bodies[person])
            for person, answer in answers.items()
            if isinstance(answer, BodyState) and answer.tracking != Tracking.LOST
        }
        self._topics.publish_bodies(tracked)
        by_id = {self._topics.id_of(p): body for p, body in tracked.items()}
        self._update_bodies(by_id, stamp_ns)
        self._topics.publish_states(answers, stamp_ns)

    def _filtered(self, people: FittedPeople) -> dict[int, Answer]:
        """Let everybody's filter answer a set; points that cannot be used count as not seen."""
        try:
            return self._filters.step(people)
        except InputError as error:
            self._drop(error)
            unseen = PeoplePoints(dict.fromkeys(people.points.of, NOTHING_SEEN))
            return self._filters.step(replace(people, points=unseen))

    def _on_silence(self, silent_s: float) -> None:
        with self._answering:
            if not self._active:
                return
            reason = f"no frame sets for {silent_s:.0f} s"
            state = self._topics.publish_stale(reason)
            self._update_bodies({}, self.get_clock().now().nanoseconds)
            self.health.status(LEVELS[state], f"{state}: {reason}")

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._answering:
            self._order.reset()
            self._filters.reset()
        response.success, response.message = True, "everybody's next set with a visible torso starts anew"
        return response

    def _update_bodies(self, tracked: Tracked, stamp_ns: int) -> None:
        for bodies in self._bodies:
            bodies.update(tracked, stamp_ns)

    def _forget(self, body_id: str) -> None:
        for bodies in self._bodies:
            bodies.forget(body_id)

    def _drop(self, error: InputError) -> None:
        self.health.count("bad_points")
        self.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)


def summary_of(answers: dict[int, Answer]) -> str:
    """Return in one line how it stands with everybody: state and reason."""
    each = [f"{answer.tracking}: {answer.reason}" for answer in answers.values()]
    return each[0] if len(each) == 1 else "; ".join(f"{p} {text}" for p, text in zip(answers, each, strict=True))


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``ekf_tracker``."""
    sys.exit(run_node(EkfNode, args))


if __name__ == "__main__":
    main()
