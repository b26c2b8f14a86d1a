"""What the page's buttons do to the graph: lifecycle, background, recording."""

from __future__ import annotations

from pathlib import Path

from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.verdict import REDO

from ..graph.background_training import SERVICE, SERVICE_TYPE, camera_of, progress_of, train_backgrounds
from ..graph.diagnostics_table import DiagnosticsTable
from ..graph.lifecycle_client import LifecycleClient, State, groups_of
from ..graph.ros_link import RosLink, call_all, our_nodes, owners_of
from ..graph.topics import DIAGNOSTICS, OUTPUT_TOPICS
from ..recording.recorder import Recorder, read_configuration, rig_of_configuration
from ..takes.folder import TakesFolder
from ..takes.summary_file import finish_take
from .jobs import Jobs, Tell, Work

RESET, RESET_TYPE = "reset", "std_srvs/srv/Trigger"
RESET_TIMEOUT_S, PARAMETERS_TIMEOUT_S = 5.0, 2.0


class Control:
    """Makes the work that the graph's buttons ask for; a recording goes on between two requests."""

    def __init__(self, link: RosLink, diagnostics: DiagnosticsTable, takes: TakesFolder, jobs: Jobs) -> None:
        """``takes`` : the folder into which recordings go. ``jobs`` : runs the work."""
        self._link, self._diagnostics, self._takes, self._jobs = link, diagnostics, takes, jobs
        self._lifecycle = LifecycleClient(link.node)
        self._recorder: Recorder | None = None
        self._recording_to: Path | None = None

    @property
    def recording(self) -> str:
        """The name of the take being recorded, empty while there is none."""
        return self._recording_to.name if self._recording_to is not None else ""

    def close(self) -> None:
        """Finish a recording under way."""
        self._jobs.cancel()
        if self._recorder is not None:
            self.stop_recording(lambda text: None)

    # what can be asked for --------------------------------------------------------------------------------------------

    def bring(self, goal: State, cameras_first: bool) -> Work:
        """Bring every node to a lifecycle state."""

        def work(tell: Tell) -> str:
            names = sorted(our_nodes(self._link.node))
            if not names:
                return "no nodes of ours are in the graph: start them with `sagoma up` or their launch file"
            outcome = self._lifecycle.bring(groups_of(names, cameras_first), goal)
            failures = "; ".join(map(str, outcome.failures))
            return failures or f"{len(names)} nodes are {goal.value}"

        return work

    def reset(self, tell: Tell) -> str:
        """Forget all persons, and look for them anew."""
        owners = owners_of(self._link.node, RESET, RESET_TYPE)
        requests = {f"{owner}/{RESET}": Trigger.Request() for owner in sorted(owners)}
        if not requests:
            return "no tracker is in the graph"
        replies = call_all(self._link.node, Trigger, requests, RESET_TIMEOUT_S)
        return "; ".join(
            f"{service.rpartition('/')[0]}: {reply.message if reply is not None else 'did not answer'}"
            for service, reply in replies.items()
        )

    def learn_background(self, countdown_s: int) -> Work:
        """Count down while the person leaves the room, then train every camera."""

        def work(tell: Tell) -> str:
            names = sorted(owners_of(self._link.node, SERVICE, SERVICE_TYPE))
            if not names:
                return "no camera client is in the graph"
            for left in range(countdown_s, 0, -1):
                tell(f"leave the room: {left}")
                if self._jobs.cancelled.wait(1.0):
                    return "cancelled: the background is as it was"

            def progress() -> bool:
                done = ", ".join(f"{camera_of(name)} {progress_of(self._diagnostics, name) or '...'}" for name in names)
                tell(f"learning: {done}")
                return not self._jobs.cancelled.is_set()

            outcomes = train_backgrounds(self._link.node, self._diagnostics, names, wanted=progress)
            failed = [outcome for outcome in outcomes if outcome.grade == REDO]
            if failed:
                return "; ".join(f"{outcome.camera}: {outcome.message}" for outcome in failed)
            return f"{len(outcomes)} cameras have learned their background"

        return work

    def start_recording(self, name: str) -> Work:
        """Record the graph's topics into a new take."""

        def work(tell: Tell) -> str:
            if self._recorder is not None:
                return f"{self.recording} is being recorded already"
            folder = self._takes.new_path(name)
            self._recorder = Recorder(
                self._link.node, folder, [*OUTPUT_TOPICS, DIAGNOSTICS], on_failure=self._tell_failure
            )
            self._recorder.follow_graph()
            self._recording_to = folder
            return recording_text(folder.name)

        return work

    def stop_recording(self, tell: Tell) -> str:
        """Finish the take."""
        if self._recorder is None or self._recording_to is None:
            return "nothing is being recorded"
        names = sorted(our_nodes(self._link.node))
        configuration = read_configuration(self._link.node, names, PARAMETERS_TIMEOUT_S)
        counts = self._recorder.close({"graph": configuration}, rig_of_configuration(configuration))
        folder, failure = self._recording_to, self._recorder.failure
        self._recorder, self._recording_to = None, None
        finish_take(folder)
        early = f"; {failure}" if failure is not None else ""
        return f"recorded {folder.name}: {sum(counts.values())} messages{early}"

    def _tell_failure(self, error: InputError) -> None:
        self._jobs.say(f"{error} The capture goes on.")


def recording_text(name: str) -> str:
    """Say what is being recorded."""
    return f"recording {name}"
