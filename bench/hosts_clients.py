"""`python bench/hosts.py --clients`: the same network with the programs that run on camera PCs, and the whole server.

On each camera host: a simulated GigE Vision camera on its own loopback, `sagoma up --cameras` with the real client
(Aravis, background learned by `sagoma background`), and `sagoma doctor --answer`. On the server: `sagoma up --rig
--only server`. The cameras see a rendered person who moves to and fro, slowly, in step by their clocks; the truth of
that session tells the pose error. After each condition has been measured, and while it lasts, the server's doctor
examines graph and faulty host: its findings are the last column. The clock of a host is set apart by hosts_clock.c
(needs a C compiler).
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from report import Table

from hosts_camera import write_clip
from hosts_drill import SERVER, NetworkDrill, Trial, apart, cut, environment_of, jumbo, other_domain, steady, vanish
from hosts_witness import Witness
from namespaces import Condition, World
from scenes import studio_clip
from soak import ACTED_HZ, ACTED_S, SLOWER, STATURE_M, to_and_fro

from capture_rig.rig import Rig, save_rig
from capture_rig.session import Truth, load_session
from capture_rig.yaml_file import save_mapping
from stick_figure.body import Body
from virtual_studio.gige.loop import ask
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

CLIENT_HZ, FPS = 10.0, ACTED_HZ / SLOWER
SAGOMA = [sys.executable, "-m", "sagoma_tools.cli"]
BENCH = Path(__file__).resolve().parent
CAMERA_ADDRESS = "127.0.1.1"
START_S, LATEST_S, DOCTOR_S = 300.0, 1.0, 5.0
STANDS_S, SECOND_NS = 5.0, 1_000_000_000  # in the T-pose, once tracked


@dataclass(frozen=True)
class ClientRow:
    """Figures of a condition. complete, formed, tracked : shares of the exposures with a set of all cameras, a set of
    any, a tracked body; p50_ms, p95_ms : from exposure to the set being closed; answer : to the filter's answer.

    error_mm : mean of all points of the tracked bodies; noticed_s : until the server no longer knew the camera;
    recovered_s : from the fault's end until sets were whole again. found : codes of the doctor's findings, notes apart.
    """

    name: str
    complete: float
    formed: float
    p50_ms: float
    p95_ms: float
    answer_p50_ms: float
    answer_p95_ms: float
    tracked: float
    error_mm: float
    noticed_s: float | None
    recovered_s: float | None
    says: str
    found: str


class CameraPC:
    """One camera host: its camera, which has a power supply of its own, its client, and what answers the doctor."""

    def __init__(self, world: World, folder: Path, name: str, hz: float, environment: dict[str, str]) -> None:
        self.host, self.name, self._folder, self._environment = world.hosts[name], name, folder, environment
        self._control = folder / f"{name}.sock"
        session = folder / name
        session.mkdir()
        whole = load_session(folder / "session")
        save_rig(Rig(tuple(c for c in whole.rig.cameras if c.name == name), whole.rig.volume), session / "rig.yaml")
        for suffix in (".mp4", "_background.mp4"):
            (session / f"{name}{suffix}").symlink_to(folder / "session" / f"{name}{suffix}")
        shutil.copy(folder / "session" / "session.yaml", session)
        self._parameters = folder / f"{name}.yaml"
        parameters = {
            "rig_file": str(folder / "session" / "rig.yaml"),
            "source": "aravis",
            "aravis": {"address": CAMERA_ADDRESS, "frame_rate": hz},
            "background_file": str(self.background),
        }
        save_mapping(self._parameters, {f"/{name}/camera_client": {"ros__parameters": parameters}})
        scene = ["--session", str(session), "--fps", f"{hz:g}", "--empty", "--address", CAMERA_ADDRESS]
        command = [sys.executable, "-m", "virtual_studio.gige", *scene, "--control", str(self._control)]
        self._camera = self.host.start(command, environment, stdout=self._log("camera"), stderr=subprocess.STDOUT)

    @property
    def background(self) -> Path:
        """Where the client keeps what it learned."""
        return self._folder / f"{self.name}_background.npz"

    def is_on(self) -> bool:
        """Whether the camera serves its control channel."""
        return self._control.exists()

    def ask(self, do: str, **words: Any) -> None:
        """Ask something of the camera's studio (`sagoma studio`)."""
        ask({"do": do, **words}, self._control)

    def start(self, **environment: str) -> float:
        """Switch the PC on: its programs start, as a service does at boot; returns when, s of the monotonic clock."""
        begun_s = time.monotonic()
        up = [*SAGOMA, "up", "--cameras", str(self._parameters), "--run-folder", str(self._folder / f"up-{self.name}")]
        for label, command in (("up", up), ("answer", [*SAGOMA, "doctor", "--answer"])):
            told = self._log(label)
            self.host.start(command, {**self._environment, **environment}, stdout=told, stderr=subprocess.STDOUT)
        return begun_s

    def vanish(self) -> None:
        """Take its power; the camera has its own."""
        self.host.kill(spare=[self._camera.pid])

    def _log(self, label: str) -> Any:
        return (self._folder / f"{self.name}_{label}.log").open("a")


class ClientDrill(NetworkDrill):
    """Camera PCs, their backgrounds learned, a person tracked."""

    cut_s, absent_s, recover_s = 5.0, 8.0, 120.0
    heavy = -1

    def __init__(self, world: World, folder: Path, arguments: Any) -> None:
        self.world, self.folder, self.hz, self.seconds = world, folder, arguments.hz, arguments.seconds
        self._rig, truth = folder / "session" / "rig.yaml", load_session(folder / "session").truth
        assert truth is not None
        self._truth: Truth = truth
        self.environment = environment_of(world, folder, arguments)
        names = self.cameras
        self.pcs = {name: CameraPC(world, folder, name, self.hz, self.environment) for name in names}
        settings = {"tolerance_s": 0.5 / self.hz, "resend": str(arguments.resend).lower(), "backend": "cpu"}
        words = [word for key, value in settings.items() for word in ("--set", f"hull_server.{key}={value}")]
        server = ["up", "--rig", str(self._rig), "--only", "server", "--run-folder", str(folder / "up-server"), *words]
        self._sagoma(*server, log="up")
        listener = [sys.executable, str(BENCH.parent / "tests/support/hosts_listener.py"), *names]
        told = world.hosts[SERVER].start(listener, self.environment, stdout=subprocess.PIPE, text=True)
        self.witness = Witness(told)
        for pc in self.pcs.values():
            pc.start()
        self._learn()
        self._let_in()

    @property
    def last(self) -> CameraPC:
        """The PC that suffers where one does."""
        return list(self.pcs.values())[-1]

    def switch_off(self, camera: str) -> None:
        """Take a camera PC's power."""
        self.pcs[camera].vanish()

    def switch_on(self, camera: str, ahead_s: float = 0.0) -> float:
        """Start the programs of a camera PC; with another clock, wait for its client."""
        if not ahead_s:
            return self.pcs[camera].start()
        library = self.folder / "clock.so"
        if not library.exists():
            source = str(BENCH / "hosts_clock.c")
            subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", str(library), source], check=True)
        ahead = {"LD_PRELOAD": str(library), "SAGOMA_CLOCK_AHEAD_NS": str(round(ahead_s * 1e9))}
        begun_s = self.pcs[camera].start(**ahead)
        self.wait("its client", lambda: self.witness.known_since(camera, begun_s))
        return begun_s

    def _sagoma(self, *words: str, log: str) -> Any:
        sink = (self.folder / f"server_{log}.log").open("a")
        return self.world.hosts[SERVER].start([*SAGOMA, *words], self.environment, stdout=sink, stderr=sink)

    def _learn(self) -> None:
        """Let every client learn the empty room, as its operator does, again where one was not there yet."""
        self.wait("every camera", lambda: all(pc.is_on() for pc in self.pcs.values()) or None, START_S)
        self.wait("every client", lambda: self._knows_all() or None, START_S)
        deadline_s = time.monotonic() + START_S
        words = ("background", "--countdown", "0", "--repeat", "--expect", str(len(self.pcs)), "--wait", "30")
        while not all(pc.background.exists() for pc in self.pcs.values()):
            if time.monotonic() > deadline_s:
                raise RuntimeError(f"not every background was learned: {self.folder}")
            self._sagoma(*words, log="background").wait()

    def _let_in(self) -> None:
        """Let the person in, who stands in the T-pose until tracked, and then moves before all cameras at once."""
        for pc in self.pcs.values():
            pc.ask("hold")
            pc.ask("room", state="occupied")
        self.wait("a tracked body", lambda: self.witness.tracked_since(0.0), START_S)
        time.sleep(STANDS_S)
        self.begin_ns = (time.time_ns() // SECOND_NS + 2) * SECOND_NS
        for pc in self.pcs.values():
            pc.ask("play", at_ns=self.begin_ns, loop=True)
        time.sleep(STANDS_S)

    def _knows_all(self) -> bool:
        return bool(self.witness.known) and len(self.witness.known[-1]["known"]) == len(self.pcs)

    def doctor(self, pc: CameraPC | None = None) -> str:
        """Return the codes of what the server's doctor finds in the graph and on the way to a PC, notes apart."""
        words = ["doctor", "--no-machine", "--json", "--live", "--seconds", f"{DOCTOR_S:g}", "--rig", str(self._rig)]
        words += ["--host", (pc or self.last).host.address]
        server = self.world.hosts[SERVER]
        process = server.start([*SAGOMA, *words], self.environment, stdout=subprocess.PIPE, text=True)
        findings = json.loads(process.communicate()[0].splitlines()[-1])["findings"]
        grave = [f for f in findings if f["severity"] in ("warning", "error")]
        return ", ".join(sorted({f"{f['subject']}: {f['code']}" for f in grave}))

    def measure(self, name: str, seconds: float | None = None, doctor: bool = True, **times: float | None) -> ClientRow:
        """Let some time pass, and return its figures, with what the doctor then finds."""
        begin_ns, begin_s, seconds = time.time_ns(), time.monotonic(), seconds or self.seconds
        time.sleep(seconds + LATEST_S)
        row = self.figures(name, begin_ns, begin_s, seconds, **times)
        return ClientRow(**{**asdict(row), "found": self.doctor()}) if doctor else row

    def figures(self, name: str, begin_ns: int, begin_s: float, seconds: float, **times: float | None) -> ClientRow:
        """Return the figures of the exposures in ``seconds`` from an instant on."""
        sets = self.witness.figures(name, begin_ns, seconds, self.hz)
        _, p50_ms, p95_ms = self.witness.answered(begin_ns, seconds)
        errors_mm = self.witness.errors_mm(self._truth, (self.begin_ns, FPS), begin_ns, seconds)
        exposed = seconds * self.hz
        error_mm = float(errors_mm.mean()) if len(errors_mm) else float("nan")
        says = self.witness.said_mostly(begin_s, begin_s + seconds)
        shares = (sets.complete, sets.formed, sets.p50_ms, sets.p95_ms, p50_ms, p95_ms, len(errors_mm) / exposed)
        noticed_s, recovered_s = times.get("noticed_s"), times.get("recovered_s")
        return ClientRow(name, *shares, error_mm, noticed_s, recovered_s, says, "")


CONDITIONS: dict[str, Trial] = {
    "plain": steady(Condition()),
    "delay 20 ms": steady(Condition(delay_ms=20.0)),
    "jitter 0 to 15 ms": steady(Condition(jitter_ms=15.0)),
    "loss 1 %": steady(Condition(loss=0.01)),
    "loss 5 %": steady(Condition(loss=0.05)),
    "plain, again": steady(Condition()),
    "100 Mbit/s": steady(Condition(rate_mbit=100.0), everywhere=True),
    "cable cut for 5 s": cut,
    "a host vanishes": vanish,
    "clock 5 ms ahead": apart(0.005),
    "clock 2 s ahead": apart(2.0),
    "two ROS domains": other_domain,
    "one host's MTU 9000": jumbo,
    "plain, at last": steady(Condition()),
}


@contextmanager
def running(arguments: Any) -> Iterator[ClientDrill]:
    """The drill's hosts, a person tracked; nothing is left of them afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="sagoma_hosts_"))
    rig = ring(arguments.cameras - 1, True)
    body, seconds = Body.from_stature(STATURE_M), 2 * ACTED_S * SLOWER
    write_session(folder / "session", rig, body, to_and_fro, FPS, seconds)
    clip = studio_clip("walk", 1.0, arguments.cameras)
    write_clip(folder / "clip", clip.rig, [clip.masks(frame) for frame in range(len(clip))])
    names = [SERVER, *rig.names]
    try:
        with World(names, seed=arguments.seed, multicast=not arguments.peers) as world:
            print(f"{len(names)} hosts, GigE cameras at {arguments.hz:g} Hz", flush=True)
            yield ClientDrill(world, folder, arguments)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main(arguments: Any, names: list[str]) -> dict[str, Any]:
    """Run the conditions of these names one after the other."""
    columns = "condition:<28 | complete:>9.1% | formed:>8.1% | p50 ms:>7.1f | p95 ms:>7.1f | answer p50:>10.1f "
    columns += "| answer p95:>10.1f | tracked:>8.1% | error mm:>9.1f | noticed s:>9.1f | recovered s:>11.1f "
    table = Table(columns + "| hull server says:<20 | the doctor finds:<20")
    rows: list[ClientRow] = []
    with running(arguments) as drill:
        for name in names:
            for row in CONDITIONS[name](drill, name):
                rows.append(row)
                table.row(*asdict(row).values())
    return {"rows": [asdict(row) for row in rows]}
