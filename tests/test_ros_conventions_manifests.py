"""package.xml of every package: what it imports is declared, by keys that rosdep knows, and in no circle."""

import ast
import sys
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SOURCES.glob("*/package.xml"))
KEYS = {
    "cv2": "python3-opencv",
    "gi": "python3-gi",
    "hypothesis": "python3-hypothesis",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "OpenGL": "python3-opengl",
    "psutil": "python3-psutil",
    "pytest": "python3-pytest",
    "rich": "python3-rich",
    "scipy": "python3-scipy",
    "skimage": "python3-skimage",
    "websockets": "python3-websockets",
    "yaml": "python3-yaml",
}
"""Python modules -> their keys in ros/rosdistro's rosdep/python.yaml, as of Jazzy."""
FROM_PYPI = {"rosbags", "c3d", "pygltflib", "viser", "mcap"}
"""What has no key there: requirements.txt brings it."""
WITH_ANOTHER = {"llvmlite", "msgspec"}  # own requirements of numba and viser
OPTIONAL = {"hri_msgs"}  # of REP-155: looked for, and done without
SCRIPTS = {"commands_page"}  # of this repository, for the tests of what it writes
ROS = {
    *(
        "rclpy",
        "launch",
        "launch_ros",
        "launch_xml",
        "launch_testing",
        "ament_index_python",
        "tf2_msgs",
        "rosgraph_msgs",
    ),
    *("builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs", "rcl_interfaces", "sensor_msgs"),
    *("std_msgs", "std_srvs", "visualization_msgs"),
}
RUN_ONLY = {
    "sagoma_bringup": {"camera_client", "hull_server", "icp_tracker", "ekf_tracker", "mocap_pipeline", "launch_xml"},
    "sagoma_ros": {"lifecycle_msgs"},  # of rclpy's lifecycle nodes
}
"""Packages whose executables or file formats a package uses, without importing them."""


def declared(package: str, *tags: str) -> set[str]:
    manifest = ElementTree.parse(SOURCES / package / "package.xml").getroot()
    return {(element.text or "").strip() for tag in tags for element in manifest.findall(tag)}


def imported(*folders: Path) -> set[str]:
    """The first names of what the modules in these folders import, without the standard library and each other."""
    files = [file for folder in folders for file in folder.rglob("*.py")]
    names = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add((node.module or "").partition(".")[0])
    return names - set(sys.stdlib_module_names) - helpers()


@cache
def helpers() -> frozenset[str]:
    """Modules beside tests, which belong to the checkout and not to a package."""
    folders = (*SOURCES.glob("*/test"), ROOT / "tests")
    return frozenset(file.stem for folder in folders for file in folder.rglob("*.py"))


def key_of(module: str) -> str | None:
    if module in PACKAGES or module in ROS:
        return module
    return KEYS.get(module)


def needed(package: str, names: set[str]) -> set[str]:
    unknown = {n for n in names if key_of(n) is None} - FROM_PYPI - WITH_ANOTHER - OPTIONAL - SCRIPTS
    assert not unknown, f"{package} imports {sorted(unknown)}: say in KEYS or FROM_PYPI where it comes from"
    return {key for n in names if (key := key_of(n)) is not None and key != package}


@cache
def behind(package: str) -> frozenset[str]:
    """All packages of ours that a package needs to run, directly or not."""
    direct = declared(package, "exec_depend", "depend") & set(PACKAGES)
    return frozenset(direct.union(*map(behind, direct)))


@pytest.mark.parametrize("package", PACKAGES)
def test_everything_imported_is_declared_and_nothing_else(package):
    folder = SOURCES / package
    wanted = needed(package, imported(folder / package, folder / "launch"))
    given = declared(package, "exec_depend", "depend")
    assert wanted - given == set(), "add exec_depend"
    assert given - wanted - RUN_ONLY.get(package, set()) == set(), "nothing imports it"


@pytest.mark.parametrize("package", PACKAGES)
def test_what_tests_import_is_declared(package):
    given = declared(package, "exec_depend", "depend", "test_depend")
    wanted = needed(package, imported(SOURCES / package / "test"))
    # tests of basic packages use the studio, which is built on them: colcon could not order a circle
    above = {other for other in PACKAGES if package in behind(other)}
    assert wanted - given - above == set(), "add test_depend"


def test_keys_have_the_form_of_rosdep_and_the_rest_comes_from_pypi():
    ours, ros, python = set(PACKAGES), ROS, set(KEYS.values())
    for package in PACKAGES:
        for tag in ("exec_depend", "depend", "test_depend", "build_depend"):
            assert declared(package, tag) <= ours | ros | python, f"{package}: {tag}"
    required = (ROOT / "requirements.txt").read_text()
    assert all(f"\n{name}" in required for name in FROM_PYPI)


def test_no_package_needs_itself():
    order = {package: declared(package, "exec_depend", "depend", "test_depend") & set(PACKAGES) for package in PACKAGES}
    done: set[str] = set()
    while len(done) < len(order):
        ready = {package for package, needs in order.items() if package not in done and needs <= done}
        assert ready, f"in a circle: {sorted(set(order) - done)}"
        done |= ready
