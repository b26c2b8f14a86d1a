import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import take_bags
from graph_timeouts import graphs_start_within

from capture_rig.session import Session, load_session
from sagoma_bringup.graph import NodeSpec
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor
from sagoma_tools.takes.measure import finish_take
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

START_TIMEOUT_S = 60.0


@pytest.fixture(scope="session", autouse=True)
def _graphs_start_soon() -> Iterator[None]:
    """Their processes find tiny_lifecycle_node.py."""
    with graphs_start_within(START_TIMEOUT_S), pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]))
        yield


@pytest.fixture(scope="session")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of twelve frames at 20 Hz: somebody in the T-pose and at the first steps, seen by four cameras."""
    folder = tmp_path_factory.mktemp("studio") / "tour"
    return write_session(folder, ring(3, True), Body.from_stature(1.75), "tour", fps=20.0, seconds=0.6)


@pytest.fixture(scope="session")
def toured(tour: Path) -> Session:
    return load_session(tour)


@pytest.fixture(scope="session")
def take_at(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """``take_at(path, frames, ...)``: a take as take_bags.write_take makes it, measured; made once and copied."""
    made: dict[str, Path] = {}

    def place(path: Path, frames: int = 50, **options: Any) -> Path:
        key = f"{path.name} {frames} {options}"
        if key not in made:
            made[key] = take_bags.write_take(tmp_path_factory.mktemp("take") / path.name, frames, **options)
            finish_take(made[key])
        return shutil.copytree(made[key], path)

    return place


@pytest.fixture()
def supervise(tmp_path):
    """``supervise(node, ...)``: a supervisor that has started the processes of these nodes; stopped at the end."""
    running = []

    def start(*graph: NodeSpec, **options) -> Supervisor:
        supervisor = Supervisor(graph, tmp_path / "run", **options)
        running.append(supervisor)
        supervisor.start()
        return supervisor

    yield start
    for supervisor in running:
        supervisor.stop()


@pytest.fixture()
def link():
    with RosLink("sagoma_test") as link:
        yield link
