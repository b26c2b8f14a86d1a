"""The launch files: XML ones are checked piece by piece, Python ones are run against stand-ins for launch_ros."""

import importlib.util
import re
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from sagoma_bringup.graph import build_graph
from sagoma_bringup.processes import THREE_PROCESSES

PACKAGE = Path(__file__).resolve().parents[1]
LAUNCH = PACKAGE / "launch"
CONFIG = PACKAGE.parents[1] / "config"
XML_FILES = sorted(LAUNCH.glob("*.launch.xml"))
PYTHON_FILES = sorted(LAUNCH.glob("*.launch.py"))


def executables(package):
    """The console scripts that the package's setup.py names."""
    return set(re.findall(r'"(\w+) = [\w.]+:main"', (PACKAGE.parent / package / "setup.py").read_text()))


def test_there_is_a_launch_file_for_each_machine_role():
    names = {path.name for path in XML_FILES + PYTHON_FILES}
    assert names == {"server.launch.py", "camera.launch.xml", "demo.launch.py", "all_in_one.launch.py"}


@pytest.mark.parametrize("path", XML_FILES, ids=lambda path: path.name)
def test_xml_launch_file_names_packages_executables_and_described_arguments(path):
    root = ET.parse(path).getroot()
    arguments = {arg.get("name"): arg for arg in root.findall("arg")}
    assert arguments and all(arg.get("description") for arg in arguments.values())
    used = set(re.findall(r"\$\(var (\w+)\)", path.read_text()))
    assert used == set(arguments)  # every argument is used, and every used one is declared
    for node in root.findall("node"):
        assert node.get("exec") in executables(node.get("pkg"))
        assert node.get("name") and (PACKAGE.parent / node.get("pkg") / "package.xml").is_file()
    for package in re.findall(r"\$\(find-pkg-share (\w+)\)", path.read_text()):
        assert package == "sagoma_bringup"


def test_camera_launch_file_finds_an_installed_parameter_file_by_default():
    root = ET.parse(LAUNCH / "camera.launch.xml").getroot()
    default = next(arg.get("default") for arg in root.findall("arg") if arg.get("name") == "params")
    found = default.replace("$(find-pkg-share sagoma_bringup)", str(PACKAGE)).replace("$(var camera)", "cam03")
    (node,) = root.findall("node")
    assert yaml.safe_load(Path(found).read_text()).keys() == {f"/cam03/{node.get('name')}"}
    assert node.get("namespace") == "$(var camera)"


class StandIn:
    """Keeps whatever it is made with."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs


class FakeNode(StandIn):
    pass


class FakeArgument(StandIn):
    pass


class FakeFunction(StandIn):
    pass


class FakeConfiguration(StandIn):
    def perform(self, context):
        return context[self.args[0]]


@pytest.fixture()
def fake_launch(monkeypatch):
    """Modules launch and launch_ros with just the names that our launch files import."""
    contents = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": FakeArgument, "OpaqueFunction": FakeFunction},
        "launch.substitutions": {"LaunchConfiguration": FakeConfiguration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": FakeNode},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: value_type(value)},
    }
    for name, attributes in contents.items():
        module = types.ModuleType(name)
        module.__dict__.update(attributes)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "sagoma_bringup.launch_nodes", raising=False)
    yield
    sys.modules.pop("sagoma_bringup.launch_nodes", None)


def run_launch_file(path, **given):
    """The node actions that a Python launch file makes of these arguments; undeclared arguments are an error."""
    spec = importlib.util.spec_from_file_location(path.stem.replace(".", "_"), path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    entities = module.generate_launch_description()
    declared = {e.args[0]: e.kwargs for e in entities if isinstance(e, FakeArgument)}
    assert all(options.get("description") for options in declared.values())
    assert set(given) <= set(declared)
    values = {name: options["default_value"] for name, options in declared.items() if "default_value" in options}
    context = {**values, **{name: str(value) for name, value in given.items()}}
    (function,) = [e for e in entities if isinstance(e, FakeFunction)]
    return function.kwargs["function"](context)


def test_all_in_one_launch_file_starts_every_node_of_the_rig_by_itself(fake_launch):
    rig, cameras = CONFIG / "rig" / "ring4.yaml", CONFIG / "camera"
    actions = run_launch_file(LAUNCH / "all_in_one.launch.py", rig=rig, cameras=cameras, server=THREE_PROCESSES)
    graph = build_graph(rig=rig, cameras=cameras)
    assert [a.kwargs["namespace"].rstrip("/") + "/" + a.kwargs["name"] for a in actions] == [n.full_name for n in graph]
    for action, node in zip(actions, graph, strict=True):
        (parameters,) = action.kwargs["parameters"]
        assert parameters == {**node.parameters, "autostart": True}
        assert action.kwargs["executable"] in executables(action.kwargs["package"])


@pytest.mark.parametrize("autostart", ["true", "false"])
def test_server_launch_file_starts_the_server_graph_in_one_process(fake_launch, autostart):
    rig, body = CONFIG / "rig" / "ring4.yaml", next((CONFIG / "body").glob("*.yaml"))
    (action,) = run_launch_file(LAUNCH / "server.launch.py", rig=rig, body=body, autostart=autostart)
    assert "name" not in action.kwargs  # it would rename all three nodes
    assert action.kwargs["executable"] in executables(action.kwargs["package"])
    (file,) = action.kwargs["parameters"]
    nodes = [node.with_parameters({"autostart": autostart == "true"}) for node in build_graph(rig=rig, body=body)]
    assert yaml.safe_load(Path(file).read_text()) == {
        node.full_name: {"ros__parameters": dict(node.parameters)} for node in nodes
    }
    Path(file).unlink()


@pytest.mark.parametrize("autostart", ["true", "false"])
def test_server_launch_file_starts_the_nodes_with_their_parameters(fake_launch, autostart):
    rig, body = CONFIG / "rig" / "ring4.yaml", next((CONFIG / "body").glob("*.yaml"))
    given = {"rig": rig, "body": body, "autostart": autostart, "server": THREE_PROCESSES}
    actions = run_launch_file(LAUNCH / "server.launch.py", **given)
    graph = build_graph(rig=rig, body=body)
    assert [action.kwargs["name"] for action in actions] == [node.name for node in graph]
    for action, node in zip(actions, graph, strict=True):
        (parameters,) = action.kwargs["parameters"]
        assert parameters == {**node.parameters, "autostart": autostart == "true"}
        assert action.kwargs["executable"] in executables(action.kwargs["package"])


def test_demo_launch_file_plays_a_session(fake_launch, tmp_path, monkeypatch):
    asked = {}
    monkeypatch.setattr("sagoma_bringup.graph.build_graph", lambda **options: asked.update(options) or [])
    assert run_launch_file(LAUNCH / "demo.launch.py", session=tmp_path, rate="0.5", loop="true") == []
    assert asked == {"session": str(tmp_path), "rate": 0.5, "loop": True, "body": None}


def test_launch_files_load_in_a_full_ros_installation():
    pytest.importorskip("launch_ros", reason="launch_ros comes with a ROS installation only")
    from launch.launch_description_sources import AnyLaunchDescriptionSource

    from launch import LaunchContext

    for path in XML_FILES + PYTHON_FILES:
        description = AnyLaunchDescriptionSource(str(path)).get_launch_description(LaunchContext())
        assert description.get_launch_arguments()
