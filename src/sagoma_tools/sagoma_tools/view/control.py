"""What the page's buttons do to the graph: lifecycle, background, recording."""

from __future__ import annotations

import io
import threading
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import viser
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.files import describe_os_error
from capture_rig.verdict import REDO

from ..graph import ANSWER_S
from ..graph.background_training import SERVICE, SERVICE_TYPE, progress_of, train_backgrounds
from ..graph.diagnostics_table import DiagnosticsTable
from ..graph.lifecycle_client import LifecycleClient, LifecycleState
from ..graph.ros_link import RosLink, call_all, label_of, our_nodes, owners_of
from ..graph.topics import DIAGNOSTICS, OUTPUT_TOPICS
from ..recording.recorder import Recorder
from ..takes.exporting import EXPORTS, FORMATS, VIDEO, export_take, write_video
from ..takes.folder import TakesFolder
from ..takes.measure import finish_take
from ..takes.take import MIB

BUSY, RECORDING = "still busy with: {}", "recording {}"
Work = Callable[[], str]
Deliver = Callable[[str, bytes], None]
"""Sends a file of this name to the browser that requested it."""


class Jobs:
    """Runs one request at a time and reports its result; a request while one runs is refused."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = ""
        self.said = ""
        """The last report of the last request."""
        self.cancelled = threading.Event()

    def request(self, what: str, work: Work) -> bool:
        """Begin some work unless other work is under way; its last word is shown. Returns whether it began."""
        with self._lock:
            if self._running:
                self.said = BUSY.format(self._running)
                return False
            self._running, self.said = what, f"{what} ..."
        self.cancelled.clear()
        threading.Thread(target=self._run, args=(what, work), name=f"page: {what}", daemon=True).start()
        return True

    def report(self, text: str) -> None:
        """Show this text until the next report."""
        self.said = text

    def _run(self, what: str, work: Work) -> None:
        try:
            said = work()
        except InputError as error:
            said = str(error)
        except OSError as error:
            said = str(describe_os_error(error, "cannot be used"))
        except Exception as error:  # the page goes on, whatever a request met
            said = f"{what} failed: {error!r}"
        with self._lock:
            self.said, self._running = said, ""


def add_buttons(
    gui: viser.GuiApi, label: str, acts: Mapping[str, Callable[[Deliver], object]], hint: str | None = None
) -> None:
    """Add a row of buttons with their actions; an action gets a function that sends a file to the browser."""
    group = gui.add_button_group(label, tuple(acts), hint=hint)

    def clicked(event: viser.GuiEvent) -> None:
        if event.client is not None:
            acts[group.value](event.client.send_file_download)

    group.on_click(clicked)


# the buttons' requests ------------------------------------------------------------------------------------------------


RESET, RESET_TYPE = "reset", "std_srvs/srv/Trigger"


class Control:
    """Executes the requests of the graph's buttons as work of ``jobs``; a recording goes on between two requests."""

    def __init__(self, link: RosLink, diagnostics: DiagnosticsTable, takes: TakesFolder, jobs: Jobs) -> None:
        """``takes`` : the folder of recordings. ``jobs`` : runs the requests."""
        self._link, self._diagnostics, self._takes, self._jobs = link, diagnostics, takes, jobs
        self._lifecycle = LifecycleClient(link.node)
        self._recorder: Recorder | None = None

    @property
    def recording(self) -> str:
        """The name of the take being recorded, empty while there is none."""
        return self._recorder.folder.name if self._recorder is not None else ""

    def close(self) -> None:
        """Finish a recording under way."""
        self._jobs.cancelled.set()
        if self._recorder is not None:
            self.stop_recording()

    # requests ---------------------------------------------------------------------------------------------------------

    def bring(self, goal: LifecycleState) -> str:
        """Bring every node to a lifecycle state."""
        names = sorted(our_nodes(self._link.node))
        if not names:
            return "no nodes of ours are in the graph: start them with `sagoma up` or their launch file"
        outcome = self._lifecycle.bring(names, goal)
        return "; ".join(outcome.failures.values()) or f"{len(names)} nodes are {goal}"

    def reset(self) -> str:
        """Forget all persons, and find them again."""
        requests = {owner: Trigger.Request() for owner in sorted(owners_of(self._link.node, RESET, RESET_TYPE))}
        replies = call_all(self._link.node, Trigger, requests, ANSWER_S, suffix=f"/{RESET}")
        said = [f"{owner}: {reply.message if reply else 'did not answer'}" for owner, reply in replies.items()]
        return "; ".join(said) or "no tracker is in the graph"

    def learn_background(self, countdown_s: int) -> str:
        """Count down while the person leaves the room, then train every camera."""
        names = sorted(owners_of(self._link.node, SERVICE, SERVICE_TYPE))
        if not names:
            return "no camera client is in the graph"
        for left in range(countdown_s, 0, -1):
            self._jobs.report(f"leave the room: {left}")
            if self._jobs.cancelled.wait(1.0):
                return "cancelled: the background is as it was"

        def progress() -> bool:
            done = ", ".join(f"{label_of(name)} {progress_of(self._diagnostics, name) or '...'}" for name in names)
            self._jobs.report(f"learning: {done}")
            return not self._jobs.cancelled.is_set()

        outcomes = train_backgrounds(self._link.node, self._diagnostics, names, wanted=progress)
        failed = [outcome for outcome in outcomes if outcome.grade == REDO]
        if failed:
            return "; ".join(f"{outcome.camera}: {outcome.message}" for outcome in failed)
        return f"{len(outcomes)} cameras have learned their background"

    def start_recording(self, name: str) -> str:
        """Record the graph's topics into a new take."""
        if self._recorder is not None:
            return f"{self.recording} is being recorded already"
        folder = self._takes.new_path(name)
        self._recorder = Recorder(
            self._link.node,
            folder,
            [*OUTPUT_TOPICS, DIAGNOSTICS],
            on_failure=lambda error: self._jobs.report(f"{error} The capture goes on."),
        )
        self._recorder.add_new_sources()
        return RECORDING.format(folder.name)

    def stop_recording(self) -> str:
        """Finish the take."""
        recorder = self._recorder
        if recorder is None:
            return "nothing is being recorded"
        counts = recorder.close_with_graph()
        self._recorder = None
        finish_take(recorder.folder)
        early = f"; {recorder.failure}" if recorder.failure is not None else ""
        return f"recorded {recorder.folder.name}: {sum(counts.values())} messages{early}"


# takes ----------------------------------------------------------------------------------------------------------------


ALL_FORMATS = "all formats"
SHOWN_EVERY = 15  # frames of a video


def export_files(takes: TakesFolder, jobs: Jobs, name: str, kind: str, deliver: Deliver) -> str:
    """Write files of other programs into a take's folder, and send them to the browser, several as one zip."""
    take = takes.find(name)
    formats = list(FORMATS) if kind == ALL_FORMATS else [kind]
    files = export_take(take.path, take.path / EXPORTS, formats, overwrite=True, log=jobs.report)
    _deliver(files, f"{name}_{kind.replace(' ', '_')}.zip", deliver)
    return f"exported {', '.join(file.name for file in files)} into {take.name}/{EXPORTS}"


def draw_video(takes: TakesFolder, jobs: Jobs, name: str, deliver: Deliver) -> str:
    """Draw a take's video, unless it has been drawn, and send it to the browser."""
    take = takes.find(name)
    path = take.path / EXPORTS / VIDEO

    def progress(frame: int, frames: int) -> None:
        if frame % SHOWN_EVERY == 0:
            jobs.report(f"drawing the video of {name}: {100 * frame / frames:.0f} %")

    if not path.exists():
        write_video(take, path, progress=progress)
    deliver(f"{name}.mp4", path.read_bytes())
    return f"{name}/{EXPORTS}/{VIDEO}, {path.stat().st_size / MIB:.1f} MB"


def _deliver(paths: list[Path], name: str, deliver: Deliver) -> None:
    if len(paths) == 1:
        deliver(paths[0].name, paths[0].read_bytes())
        return
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in paths:
            archive.write(path, path.name)
    deliver(name, packed.getvalue())
