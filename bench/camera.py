"""Simulated GigE cameras through Aravis into camera client processes: frames lost, latency, processor time.

    python bench/camera.py --quick                            # 5 cameras at 60 Hz for 15 s
    python bench/camera.py --seconds 300 --fps 60             # the long run
    python bench/camera.py --fps 60 80 100 120                # until the machine no longer keeps up
    python bench/camera.py --fps 60 --loss 0 0.0005 0.005     # with packets lost on the way
    python bench/camera.py --fps 60 --plain                   # clients that send binary masks: cheaper
    python bench/camera.py --size 640x480 1920x1200 --colour  # silhouettes alone, in turns with OpenCV's MOG2
    python bench/camera.py --lab                              # ... in an ordinary laboratory, 1288 x 728 in colour
    python bench/camera.py --size 1280x1024 --threads         # ... by the clock, in one thread and in two

Every run is the real thing: one process serves the cameras (GigE Vision over loopback, 640 x 480 Mono8, a moving body
in a room with noise and flicker and, with --shadow, strong shadows on the floor), each camera has a client process that
learns the empty room, subtracts it, undistorts and publishes, and one subscriber takes every silhouette, as the hull
server would. Counts are the clients' own (expected = delivered + incomplete + lost). Latency runs from the capture
stamp (mid-exposure, PTP time of the simulated cameras, so the same clock) to the subscriber; `published` is the
client's own, up to the publication. cpu_per_client is in shares of one core, client_ms_per_frame the processor time of
everything in a client's process a frame delivered: Aravis's threads, silhouette, PNG, middleware, diagnostics. The last
line is JSON: the first run's figures, and all runs under "runs". Of silhouettes alone it has a frame's processor time,
ours and MOG2's on the same frames, and their ratio, for each kind of pictures; in one thread, after a warm-up. With
--threads it also has the time between two frames in one thread, and in two with two frames under way, in turns.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass
from itertools import islice, product
from pathlib import Path
from statistics import median
from typing import Any

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from report import Table, execute, finish, machine_line, parser

import cv2
import numpy as np
import psutil
from room_clips import EPOCH_NS, LOOKS, SIDE_CAMERAS, RoomClip, studio_clip
from room_methods import our_pipeline
from scenes import SHARED
from sensor_msgs.msg import CompressedImage

from camera_client.frame_processor import warm_up_silhouettes
from camera_client.silhouettes.pipeline import SilhouettePipeline
from capture_rig import Rig
from capture_rig.errors import InputError
from capture_rig.session import load_session
from capture_rig.video import Video
from mocap_packets.silhouette import Silhouette
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.session_footage import pipeline_of
from sagoma_bringup.graph import ALL_CAMERAS, build_graph, select
from sagoma_ros.qos import SILHOUETTE_SUBSCRIBER
from sagoma_tools.evaluation.live_inputs import StudioProcess, free_first_address
from sagoma_tools.graph.background_training import learn_backgrounds
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor
from sagoma_tools.graph.topics import camera_topics
from sagoma_tools.recording.reader import header_stamp_ns
from stick_figure.body import Body
from virtual_studio.__main__ import image_size
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring

PLAY_S, PLAY_FPS = 4.0, 60.0
WARM_UP_FRAMES, ROUNDS, CHUNK = 15, 5, 15
"""Of silhouettes alone: frames while compilers and caches warm up; times a clip is played there and back."""
LAB_FRAMES, LAB_HZ, LABORATORY = 100, 10.0, SHARED / "lab_two_men"
SETTLE_S = 3.0  # from the play's beginning until counting begins
COUNTED = ("expected", "delivered", "incomplete", "lost", "resent_packets", "missing_packets", "underruns")


@dataclass(frozen=True)
class Run:
    """The figures of one run, all cameras together. Shares of a core; ms."""

    cameras: int
    fps: float
    packet_loss: float
    seconds: float
    expected: int
    delivered: int
    incomplete: int
    lost: int
    resent_packets: int
    received: int
    latency_p50_ms: float
    latency_p99_ms: float
    published_p50_ms: float
    cpu_per_client: float
    client_ms_per_frame: float
    cpu_studio: float
    studio_late_p99_ms: float

    @property
    def kept_up(self) -> bool:
        """Every frame delivered, and published before the next one came, mostly."""
        return self.lost + self.incomplete == 0 and self.latency_p50_ms < 1e3 / self.fps


class SilhouetteProbe:
    """Takes every silhouette, undecoded, and notes how old it is."""

    def __init__(self, cameras: tuple[str, ...]) -> None:
        self._link, self._lock = RosLink("bench_probe"), threading.Lock()
        self._ages_ns: list[int] = []
        for camera in cameras:
            topic = camera_topics(camera)[1].name
            self._link.node.create_subscription(CompressedImage, topic, self._take, SILHOUETTE_SUBSCRIBER, raw=True)

    def ages_ms(self) -> np.ndarray:
        """The ages since the last call."""
        with self._lock:
            ages, self._ages_ns = self._ages_ns, []
        return np.array(ages) / 1e6

    def close(self) -> None:
        self._link.close()

    def _take(self, data: bytes) -> None:
        age_ns = time.time_ns() - header_stamp_ns(data)
        with self._lock:
            self._ages_ns.append(age_ns)


PLAIN_MASKS = {f"{ALL_CAMERAS}.silhouette.shadow": "remove", f"{ALL_CAMERAS}.silhouette.outline_contrast": 0.0}


def built_in_session(folder: Path, cameras: int, shadow: bool = False, size: str = "640x480") -> Path:
    """The studio's person in its room, a T-pose and some movement, with sensor noise and flicker."""
    rig, body = ring(cameras - 1, True, image_size(size)), Body.from_stature(1.75)
    return write_session(folder, rig, body, fps=PLAY_FPS, seconds=PLAY_S, settings=RenderSettings(shadow=shadow))


def measure(session: Path, folder: Path, fps: float, loss: float, seconds: float, plain: bool = False) -> Run:
    """One run: studio, clients, probe; the clients' counts from SETTLE_S after the play has begun."""
    cameras = len(load_session(session).rig.names)
    arguments = ("--session", str(session), "--fps", f"{fps:g}", "--empty", "--address", free_first_address(cameras))
    with StudioProcess(folder / "studio", *arguments) as studio:
        settings = {f"{ALL_CAMERAS}.aravis.sync": "ptp", **(PLAIN_MASKS if plain else {})}
        graph = select(build_graph(rig=studio.rig, cameras=studio.cameras, settings=settings), ALL_CAMERAS)
        with Supervisor(graph, folder / "logs") as supervisor:
            supervisor.configure(tolerate_cameras=False)
            probe = SilhouetteProbe(tuple(spec.label for spec in graph))
            try:
                supervisor.activate(tolerate_cameras=False)
                learn_backgrounds(supervisor)
                studio.ask("play", loop=True)
                studio.ask("set", faults={"packet_loss": loss})
                return _count(studio, supervisor, probe, fps, loss, seconds)
            finally:
                probe.close()


def _count(
    studio: StudioProcess, supervisor: Supervisor, probe: SilhouetteProbe, fps: float, loss: float, seconds: float
) -> Run:
    still = threading.Event()
    still.wait(SETTLE_S)
    names = [spec.full_name for spec in supervisor.graph]
    before, cpu_before, began_s = _totals(supervisor, names), _cpu(supervisor, studio), time.monotonic()
    probe.ages_ms()
    published: list[float] = []
    while time.monotonic() < began_s + seconds:
        still.wait(1.0)
        reports = [supervisor.diagnostics.report(name) for name in names]
        published += [float(r.values["latency_p50_ms"]) for r in reports if r and "latency_p50_ms" in r.values]
    ages, after, cpu_after = probe.ages_ms(), _totals(supervisor, names), _cpu(supervisor, studio)
    took_s = time.monotonic() - began_s
    clients, served = ((cpu_after[k] - cpu_before[k]) / took_s for k in (0, 1))
    lateness = [camera["late_us"]["p99"] for camera in studio.ask("status")["cameras"].values()]
    counts = {key: after[key] - before[key] for key in COUNTED}
    return Run(
        cameras=len(names),
        fps=fps,
        packet_loss=loss,
        seconds=round(took_s, 1),
        expected=counts["expected"],
        delivered=counts["delivered"],
        incomplete=counts["incomplete"],
        lost=counts["lost"],
        resent_packets=counts["resent_packets"],
        received=len(ages),
        latency_p50_ms=_ms(np.percentile(ages, 50)) if len(ages) else float("nan"),
        latency_p99_ms=_ms(np.percentile(ages, 99)) if len(ages) else float("nan"),
        published_p50_ms=_ms(median(published)) if published else float("nan"),
        cpu_per_client=round(clients / len(names), 3),
        client_ms_per_frame=_ms(1e3 * clients * took_s / max(counts["delivered"], 1)),
        cpu_studio=round(served, 3),
        studio_late_p99_ms=_ms(max(lateness) / 1e3),
    )


def _totals(supervisor: Supervisor, names: list[str]) -> Mapping[str, int]:
    """The clients' counters, added up. Raises InputError where one has not reported."""
    totals = dict.fromkeys(COUNTED, 0)
    for name in names:
        report = supervisor.diagnostics.report(name)
        if report is None:
            raise InputError("has not reported", where=name, remedy="Look into its log.")
        for key in COUNTED:
            totals[key] += int(report.values.get(key, 0))
    return totals


def _cpu(supervisor: Supervisor, studio: StudioProcess) -> tuple[float, float]:
    """Processor time so far, s: of all clients together, and of the studio."""
    served = psutil.Process(studio.pid).cpu_times()
    return sum(used.cpu_s for used in supervisor.processes.usage().values()), served.user + served.system


def _ms(value: float) -> float:
    return round(float(value), 2)


def print_runs(runs: list[Run]) -> None:
    """One row a run."""
    table = Table(
        "cameras:>7d | Hz:>5g | packet loss:>11.3% | s:>5.0f | expected:>8d | delivered:>9d | "
        "incomplete:>10d | lost:>6d | resent packets:>14d | latency p50 ms:>14.2f | p99 ms:>7.2f | "
        "published p50 ms:>16.2f | core/client:>11.3f | client ms/frame:>15.2f | core studio:>11.3f | "
        "late p99 ms:>11.2f",
        "simulated GigE cameras -> Aravis -> camera clients -> subscriber",
    )
    for r in runs:
        shown = asdict(r)
        shown.pop("received")
        table.row(*shown.values())


# --- silhouettes alone


def studio_pictures(size: str, colour: bool) -> tuple[RoomClip, SilhouettePipeline]:
    """A clip of one of the studio's cameras with pictures of a size, "WIDTHxHEIGHT", and its silhouettes."""
    whole = ring(SIDE_CAMERAS, size=image_size(size))
    rig = Rig(whole.cameras[:2], whole.volume)  # a hull needs two
    look = next(look for look in LOOKS if look.colour == colour)
    clip = studio_clip(look, PLAY_S, rig)
    return clip, our_pipeline(clip, {}).cameras[rig.names[0]]


def in_turns(chain: SilhouettePipeline, frames: list[np.ndarray], empty: Iterable[np.ndarray], hz: float) -> np.ndarray:
    """Milliseconds of processor time (2, n) of our silhouettes and of MOG2 on each frame but the first ones."""
    rival, times = cv2.createBackgroundSubtractorMOG2(), []
    for image in empty:
        rival.apply(image)
    for number, image in enumerate(frames):
        begin = time.process_time()
        chain.run(image, EPOCH_NS + round(number * 1e9 / hz))
        between = time.process_time()
        rival.apply(image)
        times.append((between - begin, time.process_time() - between))
    return 1e3 * np.array(times[WARM_UP_FRAMES:]).T


def by_threads(size: str, colour: bool, rounds: int) -> tuple[float, float]:
    """Return ms a frame by the clock, in one thread and in two: medians of chunks. AssertionError if bytes differ."""
    clip, one = studio_pictures(size, colour)
    camera = clip.rig.names[0]
    two = our_pipeline(clip, {}).cameras[camera]
    frames = [*enumerate([*clip.there_and_back().take[camera]] * rounds)]
    times = []
    with ThreadPoolExecutor(1) as pool:
        for first in range(0, len(frames), CHUNK):
            chunk, under_way, begin = frames[first : first + CHUNK], list[Future[Silhouette]](), time.perf_counter()
            alone = [one.run(image, EPOCH_NS + round(number * 1e9 / PLAY_FPS)) for number, image in chunk]
            between = time.perf_counter()
            for number, image in chunk:
                found = two.subtract(image, EPOCH_NS + round(number * 1e9 / PLAY_FPS))
                wait(under_way[-1:])
                under_way.append(pool.submit(two.segment, found))
            wait(under_way)
            times.append((between - begin, time.perf_counter() - between))
            assert all((a.mask == b.result().mask).all() for a, b in zip(alone, under_way, strict=True))
    one_ms, two_ms = 1e3 * np.median(times[1:-1], axis=0) / CHUNK
    return float(one_ms), float(two_ms)


def silhouettes(sizes: list[str], colour: bool, lab: bool, rounds: int, threads: bool) -> dict[str, Any]:
    """Print and return milliseconds a frame of ours and of MOG2, and their ratio, by the kind of pictures."""
    title = "silhouettes alone, one thread, in turns"
    table = Table("pictures:<20 | ours ms:>8.2f | MOG2 ms:>8.2f | ratio:>6.2f", title)
    figures: dict[str, Any] = {}

    def show(name: str, times: np.ndarray) -> None:
        ours, rival = times.mean(axis=1)
        table.row(name, ours, rival, ours / rival)
        figures[name] = {"ours_ms": round(ours, 2), "mog2_ms": round(rival, 2), "ratio": round(ours / rival, 3)}

    for size, coloured in product(sizes, (False, True) if colour else (False,)):
        warm_up_silhouettes(coloured)  # as a node does before its first frame
        clip, chain = studio_pictures(size, coloured)
        camera = clip.rig.names[0]
        frames = [*clip.there_and_back().take[camera]] * rounds
        name = f"{size} {'colour' if coloured else 'mono'}"
        show(name, in_turns(chain, frames, clip.empty[camera], PLAY_FPS))
        if threads:
            one, two = by_threads(size, coloured, rounds)
            figures[name] |= {"one_thread_ms": round(one, 2), "two_threads_ms": round(two, 2)}
    if threads:
        by_size = Table("pictures:<20 | one thread ms:>13.2f | two ms:>8.2f | ratio:>6.2f", "between two frames")
        for name, figure in figures.items():
            one, two = figure["one_thread_ms"], figure["two_threads_ms"]
            by_size.row(name, one, two, one / two)
    if lab and LABORATORY.is_dir():
        warm_up_silhouettes(True)
        session = load_session(LABORATORY)
        for name, chain in pipeline_of(session, Configuration.of({})).cameras.items():
            with Video(session.videos[name]) as video:
                show(f"laboratory {name}", in_turns(chain, [*islice(video, 0, LAB_FRAMES)], (), LAB_HZ))
    return figures


def main() -> None:
    """Run every combination of rate and packet loss; stops raising the rate where the machine no longer keeps up."""
    given = parser(__doc__, quick="one run of 15 s")
    given.add_argument("--cameras", type=int, default=5)
    given.add_argument("--fps", type=float, nargs="+", default=[60.0])
    given.add_argument("--loss", type=float, nargs="+", default=[0.0], help="share of the packets lost on the way")
    given.add_argument("--seconds", type=float, default=60.0, help="length of a run")
    given.add_argument("--shadow", action="store_true", help="strong shadows on the floor: the hardest scene")
    given.add_argument("--plain", action="store_true", help="masks of two levels, each camera judging for itself")
    given.add_argument("--session", help="what the cameras see (default: the built-in person, rendered now)")
    given.add_argument(
        "--size", nargs="+", metavar="WxH", default=[], help="silhouettes alone, pictures of these sizes"
    )
    given.add_argument("--threads", action="store_true", help="with --size: in one thread and in two, too")
    given.add_argument("--colour", action="store_true", help="with --size: in colour, too")
    given.add_argument("--lab", action="store_true", help="silhouettes alone, of the laboratory of the test data")
    args = given.parse_args()
    if args.size or args.lab:
        rounds = 1 if args.quick else ROUNDS
        finish({"silhouettes": silhouettes(args.size, args.colour, args.lab, rounds, args.threads)})
        return
    seconds = 15.0 if args.quick else args.seconds
    runs = list[Run]()
    folder = Path(tempfile.mkdtemp(prefix="sagoma_bench_camera_"))
    try:
        session = (
            Path(args.session) if args.session else built_in_session(folder / "session", args.cameras, args.shadow)
        )
        for fps in args.fps:
            for loss in args.loss:
                runs.append(measure(session, folder / f"{fps:g}_{loss:g}", fps, loss, seconds, args.plain))
                print(f"{fps:g} Hz, packet loss {loss:g}: done", file=sys.stderr)
            if not runs[-1].kept_up and args.loss == [0.0]:
                break
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print_runs(runs)
    if args.loss == [0.0] and len(args.fps) > 1:
        stopped = "" if runs[-1].kept_up else f"; it stops at {runs[-1].fps:g} Hz"
        kept = [run.fps for run in runs if run.kept_up]
        print(f"this machine keeps up at {max(kept):g} Hz{stopped}" if kept else "this machine does not keep up")
    print(machine_line())
    finish({**asdict(runs[0]), "runs": [asdict(run) for run in runs]})


if __name__ == "__main__":
    execute(main)
