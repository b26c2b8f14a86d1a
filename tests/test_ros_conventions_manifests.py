"""package.xml of every package: what it imports is declared, by keys that rosdep knows, and in no circle."""

import ast
import sys
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SOURCES.glob("*/package.xml"))
PACKAGED = "gi hypothesis matplotlib numpy OpenGL psutil pytest rich scipy skimage websockets yaml"
FROM_PIP = "c3d mcap numba pygltflib rosbags viser"
KEYS = {"cv2": "python3-opencv-headless-pip", "pythonosc": "python3-python-osc-pip"}
KEYS |= {module: f"python3-{module.lower()}" for module in PACKAGED.split()}
KEYS |= {module: f"python3-{module}-pip" for module in FROM_PIP.split()}
"""Python modules -> rosdep keys."""
ROSDEP = yaml.safe_load((ROOT / "rosdep.yaml").read_text())
"""Our own keys, with the rules of each system."""
ROSDISTRO = {
    line for line in (Path(__file__).parent / "support/rosdistro_keys.txt").read_text().splitlines() if line[:1] != "#"
}
WITH_ANOTHER = {"llvmlite", "msgspec"}  # own requirements of numba and viser
OPTIONAL = {"hri_msgs", "pylsl"}  # of REP-155 and of the bridge to LSL: looked for, and done without
SCRIPTS = {"commands_page"}  # of this repository, for the tests of what it writes
RUN_ONLY = {
    "camera_client": {"gir1.2-aravis-0.8"},
    "hull_server": {"egl-mesa"},
    "sagoma_bringup": {"camera_client", "hull_server", "icp_tracker", "ekf_tracker", "mocap_pipeline", "launch_xml"},
    "sagoma_ros": {"lifecycle_msgs"},  # of rclpy's lifecycle nodes
}
"""What a package needs without importing it: executables, file formats, libraries behind its modules."""


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
    return module if module in PACKAGES or module in ROSDISTRO else KEYS.get(module)


def needed(package: str, names: set[str]) -> set[str]:
    unknown = {n for n in names if key_of(n) is None} - WITH_ANOTHER - OPTIONAL - SCRIPTS
    assert not unknown, f"{package} imports {sorted(unknown)}: say in KEYS where it comes from"
    return {key for n in names if (key := key_of(n)) is not None and key != package}


@cache
def behind(package: str) -> frozenset[str]:
    """All packages of ours that a package needs to run, directly or not."""
    direct = declared(package, "exec_depend", "depend") & set(PACKAGES)
    return frozenset(direct.union(*map(behind, direct)))


@pytest.mark.parametrize("package", PACKAGES)
def test_everything_imported_is_declared_by_known_keys_and_nothing_else(package):
    folder = SOURCES / package
    wanted = needed(package, imported(folder / package, folder / "launch"))
    given = declared(package, "exec_depend", "depend")
    assert wanted - given == set(), "add exec_depend"
    assert given - wanted - RUN_ONLY.get(package, set()) == set(), "nothing imports it"
    for_tests = given | declared(package, "test_depend")
    # tests of basic packages use the studio, which is built on them: colcon could not order a circle
    above = {other for other in PACKAGES if package in behind(other)}
    assert needed(package, imported(folder / "test")) - for_tests - above == set(), "add test_depend"
    keys = for_tests | declared(package, "build_depend")
    assert keys - set(PACKAGES) - ROSDISTRO - set(ROSDEP) == set(), "no key of rosdistro or ours"


def test_no_package_needs_itself():
    order = {package: declared(package, "exec_depend", "depend", "test_depend") & set(PACKAGES) for package in PACKAGES}
    done: set[str] = set()
    while len(done) < len(order):
        ready = {package for package, needs in order.items() if package not in done and needs <= done}
        assert ready, f"in a circle: {sorted(set(order) - done)}"
        done |= ready
