"""The launch files, run against a stand-in for launch and launch_ros: the graph that each starts, what it refuses."""

import os
import sys
import threading
from pathlib import Path

import pytest
import yaml
from launch_stand_in import launched, module_of

from capture_rig.errors import InputError
from sagoma_bringup.graph import SERVER_NODES, THREE_PROCESSES, build_graph, processes_of
from sagoma_bringup.launch_arguments import PLAY_IN_STEP, RESTART_DELAY_S
from sagoma_tools.graph import START_TIMEOUT_S
from sagoma_tools.graph.ros_link import RosLink, our_nodes, settled

PACKAGE = Path(__file__).resolve().parents[1]
LAUNCH = PACKAGE / "launch"
CONFIG = PACKAGE.parents[1] / "config"
RIG, CAMERAS, BODY = CONFIG / "rig" / "ring4.yaml", CONFIG / "camera", CONFIG / "body" / "default.yaml"
FILES = sorted(LAUNCH.glob("*.launch.*"))
DEMO = LAUNCH / "demo.launch.py"
RIG_FILES = [LAUNCH / name for name in ("server.launch.py", "server.launch.xml", "all_in_one.launch.py")]


def parameters_of(node) -> dict:
    """What the node's own file sets, by node name."""
    return {
        key.removeprefix("/**/"): entry["ros__parameters"]
        for key, entry in yaml.safe_load(Path(node.parameters[0]).read_text()).items()
    }


def of_graph(processes) -> list[tuple]:
    return [
        (p.package, p.executable, p.nodes[0].namespace, {node.name: dict(node.parameters) for node in p.nodes})
        for p in processes
    ]


def of_launch(nodes) -> list[tuple]:
    return [(n.package, n.executable, n.full_namespace or "/", parameters_of(n)) for n in nodes]


def arguments_for(path, **more) -> dict:
    return {"rig": RIG, **({"cameras": CAMERAS} if path.name.startswith("all") else {}), **more}


# --- the graph


@pytest.mark.parametrize("server", ["one_process", THREE_PROCESSES])
@pytest.mark.parametrize("path", [*RIG_FILES, DEMO], ids=lambda path: path.name)
def test_a_launch_file_starts_the_graph_of_build_graph(path, server, session):
    given = {"session": session, "rate": 1.0} if path == DEMO else arguments_for(path, body=BODY)
    settings = {"icp_tracker.initial_pose.source": "auto", **(PLAY_IN_STEP if path == DEMO else {})}
    graph = [node.with_parameters({"autostart": True}) for node in build_graph(**given, settings=settings)]
    nodes = launched(path, **given, server=server)
    assert of_launch(nodes) == of_graph(processes_of(graph, server))
    assert path == DEMO or {(node.respawn, node.respawn_delay) for node in nodes} == {(True, RESTART_DELAY_S)}


def test_the_camera_launch_files_start_the_client_of_one_camera(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # from anywhere
    in_python, in_xml = (launched(LAUNCH / f"camera.launch.{kind}", camera="cam03") for kind in ("py", "xml"))
    assert of_launch(in_python) == of_launch(in_xml)
    ((package, executable, namespace, parameters),) = of_launch(in_xml)
    (node,) = build_graph(cameras=CAMERAS / "cam03.yaml")
    assert (package, executable, namespace) == ("camera_client", "camera_client", "/cam03")
    assert parameters == {"camera_client": {**node.parameters, "autostart": True}}


@pytest.mark.parametrize("rig", ["package://sagoma_bringup/config/rig/ring4.yaml", str(RIG), "rig/ring4.yaml"])
def test_a_rig_is_named_by_package_by_absolute_or_by_relative_path(rig, monkeypatch):
    monkeypatch.chdir(CONFIG)
    (camera,) = launched(LAUNCH / "camera.launch.xml", camera="cam01", rig=rig)
    assert Path(parameters_of(camera)["camera_client"]["rig_file"]).samefile(RIG)
    (server,) = launched(LAUNCH / "server.launch.py", rig=rig)
    assert Path(parameters_of(server)["hull_server"]["rig_file"]).samefile(RIG)


def test_arguments_reach_the_nodes_that_they_are_for(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("/**/hull_server: {ros__parameters: {voxel_size_m: 0.03}}")
    given = {"start": "t_pose", "use_sim_time": "true", "autostart": "false", "params": file}
    (server,) = launched(LAUNCH / "server.launch.py", rig=RIG, **given)
    parameters = parameters_of(server)
    assert all(parameters[name]["use_sim_time"] and not parameters[name]["autostart"] for name in SERVER_NODES)
    assert parameters["icp_tracker"]["initial_pose.source"] == "t_pose"
    assert server.parameters[1:] == [str(file)]  # read last


@pytest.mark.parametrize(
    ("argument", "pushed", "expected"),
    [("", None, ""), ("studio", None, "/studio"), ("", "/lab", "/lab"), ("studio", "lab", "/lab/studio")],
)
def test_the_whole_graph_stands_below_a_namespace(argument, pushed, expected):
    nodes = launched(LAUNCH / "all_in_one.launch.py", pushed, rig=RIG, cameras=CAMERAS, namespace=argument)
    found = [(node.full_namespace or "/").rstrip("/") for node in nodes]
    assert found == [expected, *(f"{expected}/cam0{k}" for k in range(1, 5))]
    prefixes = {each.get("tf_prefix", "") for node in nodes for each in parameters_of(node).values()}
    assert prefixes == {argument and f"{argument}_"}


# --- what is refused, before anything starts


@pytest.mark.parametrize(
    ("file", "given", "message"),
    [
        ("server.launch.py", {"rig": RIG, "params": "nowhere.yaml"}, "cannot be read"),
        ("demo.launch.py", {"rate": "soon"}, "argument rate: is soon.*[Gg]ive a number from 0"),
        ("server.launch.xml", {"rig": "package://no_such_package/rig.yaml"}, "no package 'no_such_package'"),
        ("camera.launch.py", {"camera": "cam09"}, r"cam09\.yaml: cannot be read"),
        ("camera.launch.xml", {"camera": "cam01", "params": CAMERAS / "cam02.yaml"}, "describes cam02, not cam01"),
        ("demo.launch.py", {"session": "nowhere"}, "nowhere"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_starts(file, given, message, session):
    given = {"session": session, **given} if file.startswith("demo") else given
    with pytest.raises(InputError, match=message):
        launched(LAUNCH / file, **given)


def test_executables_of_all_launched_packages_are_there():
    for node in launched(LAUNCH / "all_in_one.launch.py", rig=RIG, cameras=CAMERAS, server=THREE_PROCESSES):
        assert module_of(node.package, node.executable)


# --- the real launch: it is not on PyPI


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The packages of this checkout as ament and launch_ros find installed ones."""
    executables = {"camera_client": "camera_client", "mocap_pipeline": "mocap_server"}
    executables |= {name: name for name in SERVER_NODES}
    for package in ("sagoma_bringup", *executables):
        share = tmp_path / "share" / package
        share.parent.mkdir(exist_ok=True)
        share.symlink_to(PACKAGE.parent / package)
        index = tmp_path / "share/ament_index/resource_index/packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
    for package, executable in executables.items():
        script = tmp_path / "lib" / package / executable
        script.parent.mkdir(parents=True)
        script.write_text(f"#!{sys.executable}\nfrom {module_of(package, executable)} import main\nmain()\n")
        script.chmod(0o755)
    before = [path for path in [os.environ.get("AMENT_PREFIX_PATH")] if path]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([str(tmp_path), *before]))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_real_launch_runs_what_the_stand_in_does_and_ends_it_in_order(path, installed, session):
    pytest.importorskip("launch_ros", reason="launch and launch_ros come with a ROS installation only")
    from launch.actions import IncludeLaunchDescription, RegisterEventHandler
    from launch.event_handlers import OnProcessExit, OnProcessStart
    from launch.launch_description_sources import AnyLaunchDescriptionSource

    from launch import LaunchDescription, LaunchService

    role = path.name.partition(".")[0]
    own = {"camera": {"camera": "cam01"}, "demo": {"session": session}}
    given = {"autostart": "false", "namespace": "studio", **own.get(role, arguments_for(path))}
    expected = [node.full_namespace for node in launched(path, **given)]
    nodes = sum(len(parameters_of(node)) for node in launched(path, **given))
    started, ended, found = [], [], []

    service = LaunchService(noninteractive=True)
    service.include_launch_description(
        LaunchDescription(
            [
                RegisterEventHandler(OnProcessStart(on_start=lambda event, _: started.extend(event.cmd))),
                RegisterEventHandler(OnProcessExit(on_exit=lambda event, _: ended.append(event.returncode))),
                IncludeLaunchDescription(
                    AnyLaunchDescriptionSource(str(path)),
                    launch_arguments=[(name, str(value)) for name, value in given.items()],
                ),
            ]
        )
    )

    def end_when_all_are_there():
        with RosLink("listener", namespace="/studio") as link:
            found.extend(settled(lambda: our_nodes(link.node), nodes, START_TIMEOUT_S))
        service.shutdown()

    watcher = threading.Thread(target=end_when_all_are_there)
    watcher.start()
    status = service.run()
    watcher.join()
    assert len(found) == nodes and status == 0
    namespaces = [word.removeprefix("__ns:=") for word in started if word.startswith("__ns:=")]
    assert sorted(namespaces) == sorted(expected) and ended == [0] * len(expected)
