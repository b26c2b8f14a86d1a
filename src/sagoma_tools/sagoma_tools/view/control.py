"""What the page's buttons do to the graph: one thing at a time, on a thread of its own, told as it goes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.verdict import REDO

from ..graph.background_training import SERVICE, SERVICE_TYPE, camera_of, progress_of, train_backgrounds
from ..graph.diagnostics_table import DiagnosticsTable
from ..graph.lifecycle_client import LifecycleClient, State, groups_of
from ..graph.ros_link import RosLink, call_all, our_nodes, owners_of
from ..graph.topics import DIAGNOSTICS, OUTPUT_TOPICS
from ..recording.recorder import Recorder, read_configuration
from ..takes.folder import TakesFolder
from ..takes.summary_file import finish_take

RESET, RESET_TYPE = "reset", "std_srvs/srv/Trigger"
RESET_TIMEOUT_S, PARAMETERS_TIMEOUT_S = 5.0, 2.0
BUSY = "still busy with: {}"
Tell = Callable[[str], None]
Work = Callable[[Tell], str]


class Control:
    """Runs requests one after the other's end, and says what came of each; a request while one runs is refused."""

    def __init__(self, link: RosLink, diagnostics: DiagnosticsTable, takes: TakesFolder) -> None:
        """``takes`` : the folder into which recordings go."""
        self._link, self._diagnostics, self._takes = link, diagnostics, takes
        self._lifecycle = LifecycleClient(link.node)
        self._lock = threading.Lock()
        self._running = ""
        self._said = ""
        self._recorder: Recorder | None = None
        self._recording_to: Path | None = None
        self._cancel = threading.Event()

    @property
    def said(self) -> str:
        """What the last request said last."""
        with self._lock:
            return self._said

    @property
    def recording(self) -> str:
        """The name of the take being recorded, empty while there is none."""
        return self._recording_to.name if self._recording_to is not None else ""

    def request(self, what: str, work: Work) -> bool:
        """Begin some work unless other work is under way; its last word is shown. Returns whether it began."""
        with self._lock:
            if self._running:
                self._said = BUSY.format(self._running)
                return False
            self._running, self._said = what, f"{what} ..."
        self._cancel.clear()
        threading.Thread(target=self._run, args=(what, work), name=f"page: {what}", daemon=True).start()
        return True

    def cancel(self) -> None:
        """End a countdown."""
        self._cancel.set()

    def close(self) -> None:
        """Finish a recording under way."""
        self._cancel.set()
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
                if self._cancel.wait(1.0):
                    return "cancelled: the background is as it was"

            def progress() -> bool:
                done = ", ".join(f"{camera_of(name)} {progress_of(self._diagnostics, name) or '...'}" for name in names)
                tell(f"learning: {done}")
                return not self._cancel.is_set()

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
            return f"recording {folder.name}"

        return work

    def stop_recording(self, tell: Tell) -> str:
        """Finish the take."""
        if self._recorder is None or self._recording_to is None:
            return "nothing is being recorded"
        names = sorted(our_nodes(self._link.node))
        configuration = read_configuration(self._link.node, names, PARAMETERS_TIMEOUT_S)
        counts = self._recorder.close({"graph": configuration})
        folder, failure = self._recording_to, self._recorder.failure
        self._recorder, self._recording_to = None, None
        finish_take(folder)
        early = f"; {failure}" if failure is not None else ""
        return f"recorded {folder.name}: {sum(counts.values())} messages{early}"

    def _run(self, what: str, work: Work) -> None:
        try:
            said = work(self._tell)
        except InputError as error:
            said = str(error)
        except Exception as error:  # the page goes on, whatever a request met
            said = f"{what} failed: {error!r}"
        with self._lock:
            self._said, self._running = said, ""

    def _tell_failure(self, error: InputError) -> None:
        self._tell(f"{error} The capture goes on.")

    def _tell(self, text: str) -> None:
        with self._lock:
            self._said = text
