"""Servers for bench/live.py: hull, ICP and EKF nodes of this tree or another commit's, each in its own ROS domain."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from clips import Clip

from capture_rig import save_rig
from capture_rig.errors import InputError
from sagoma_bringup.graph import SERVER, apply_settings, server_graph
from sagoma_tools.graph.processes import Child, stop_children

TREE = Path(__file__).resolve().parents[1]
GRACE_S = 8.0
TOLERANCE_S = 0.001  # the player gives all silhouettes of an instant one stamp, at any rate
PROCESSES: Mapping[str, tuple[str, ...]] = {
    "one": ("mocap_pipeline.server_node",),
    "three": ("hull_server.hull_node", "icp_tracker.icp_node", "ekf_tracker.ekf_node"),
}  # modules to run, one a process


@dataclass(frozen=True)
class Server:
    """A running server: the name of its column, and its player."""

    name: str
    player: subprocess.Popen[str]
    log: Path

    def play(self, hz: float, seconds: float) -> dict[str, Any]:
        """Play the clip for so long; returns the fields of a `Turn`. Raises InputError when the player ends."""
        return self._ask({"hz": hz, "seconds": seconds})

    def play_phases(self, phases: Sequence[tuple[float, float]]) -> list[dict[str, Any]]:
        """Play at each rate (Hz) for its seconds, following the server's rule; returns the fields of each `Phase`."""
        return self._ask({"phases": list(phases)})

    def _ask(self, what: Mapping[str, Any]) -> Any:
        assert self.player.stdin is not None and self.player.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self.player.stdin.write(json.dumps(what) + "\n")
            self.player.stdin.flush()
        line = self.player.stdout.readline()
        if not line:
            end = "\n".join(self.log.read_text(errors="replace").splitlines()[-8:])
            raise InputError(f"the player ended: {end}", where=self.name, remedy=f"Look into {self.log.parent}.")
        return json.loads(line)


@contextlib.contextmanager
def running(
    name: str, tree: Path, processes: str, clip: Clip, folder: Path, domain: int, settings: Mapping[str, Any]
) -> Iterator[Server]:
    """The server of a source tree, and a player that sends it the clip; both end with the context."""
    folder.mkdir(parents=True)
    rig, packed = folder / "rig.yaml", folder / "clip.pickle"
    save_rig(clip.rig, rig)
    packed.write_bytes(pickle.dumps((rig, clip.packed)))
    tolerance = {"hull_server.tolerance_s": TOLERANCE_S}
    nodes = apply_settings(server_graph(rig), {**tolerance, **clip.start_from_t_pose, **settings})
    parameters = folder / f"{SERVER}.yaml"
    documents = [node.with_parameters({"autostart": True}).parameter_document() for node in nodes]
    parameters.write_text(yaml.safe_dump({key: value for document in documents for key, value in document.items()}))
    env = environment(tree, domain)
    ros = ["--ros-args", "--disable-external-lib-logs", "--params-file", str(parameters)]
    children = [
        Child(module, [sys.executable, "-m", module, *ros], folder / f"{module}.log", env, lambda _: None)
        for module in PROCESSES[processes]
    ]
    log = folder / "player.log"
    command = [sys.executable, str(TREE / "bench" / "live_player.py"), str(packed), *(str(c.pid) for c in children)]
    pipe = subprocess.PIPE
    try:
        with log.open("w") as errors:
            player = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=errors, env=env, text=True)
        try:
            yield Server(name, player, log)
        finally:
            player.kill()
            player.communicate()
    finally:
        stop_children(children, GRACE_S)


def environment(tree: Path, domain: int) -> dict[str, str]:
    """Of a process that runs the packages of a source tree in this ROS domain."""
    packages = os.pathsep.join(str(path) for path in sorted((tree / "src").iterdir()))
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
    ros = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {**os.environ, **threads, **ros, "PYTHONPATH": packages}


def tree_of(commit: str) -> Path:
    """The source tree of a commit, its kernels compiled; kept in output/, so that the second bench starts at once."""
    where = {"cwd": TREE, "capture_output": True}
    found = subprocess.run(["git", "rev-parse", "--verify", f"{commit}^{{commit}}"], text=True, **where)
    if found.returncode:
        raise InputError(
            "there is no such commit", where=commit, remedy="Name one with --before, or none: --before ''."
        )
    tree = TREE / "output" / "bench_live" / found.stdout.strip()
    if not tree.is_dir():
        archive = subprocess.run(["git", "archive", commit, "src"], check=True, **where).stdout
        tree.parent.mkdir(parents=True, exist_ok=True)
        unpacked = Path(tempfile.mkdtemp(dir=tree.parent))
        subprocess.run(["tar", "-x"], input=archive, check=True, cwd=unpacked)
        unpacked.rename(tree)
        print(f"compiling the kernels of {commit}, once", file=sys.stderr)
        subprocess.run([sys.executable, "-m", "sagoma_tools.warm_up"], check=True, env=environment(tree, 0), cwd=tree)
    return tree
