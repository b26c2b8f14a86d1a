"""Unknown cameras are set up by the commands that a user gives, and a person is tracked; the truth only scores."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import film_webcam
import numpy as np
import pytest
from command_line import Graph, run
from film_webcam import let_in
from heard import Heard
from sensor_msgs.msg import JointState

from capture_rig.rig import load_rig
from capture_rig.yaml_file import save_mapping
from sagoma_bringup.graph import build_graph
from sagoma_tools.evaluation.live_inputs import StudioProcess, free_first_address
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor
from sagoma_tools.recording.recorder import GraphRecorder
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.recording.footage import FootagePlan, camera_errors, read_truth_floor, write_setup
from virtual_studio.rig import ring

CAMERAS = ("cam01", "cam02", "cam03")


def calibrate_lens(name: str, board: Path, lenses: Path) -> None:
    given = ("--topic", f"/{name}/image_raw", "--board", board, "--output", lenses, "--seconds", "120", "--wait", "60")
    run("calibrate", "intrinsics", *given)


def person_live(studio: StudioProcess, rig: Path, folder: Path) -> np.ndarray:
    """(15, 3) the person who stands in the T-pose, in the rig's world, as the whole graph says."""
    settings = {"hull_server.tolerance_s": 0.1, "hull_server.deadline_s": 2.0}
    graph = build_graph(rig=rig, cameras=studio.cameras, settings=settings)
    with Supervisor(graph, folder / "logs") as supervisor:
        supervisor.configure(tolerate_cameras=False)
        with GraphRecorder(graph, folder / "bag", provenance={}) as recorder:
            recorder.wait_for_graph()
            supervisor.activate(tolerate_cameras=False)
            studio.ask("play")
            studio.ask("hold")
            assert recorder.wait_for_count("/mocap/reference_points", 30, 120.0), "nobody was tracked"
            supervisor.suspend()
            recorder.close()
    track = tracks_from_bag(folder / "bag", lambda stamp_ns: stamp_ns)[1]
    return np.median(track.points_world[-10:], axis=0)


@pytest.mark.slow
def test_live_cameras_are_set_up_from_the_empty_room_to_a_tracked_person(tmp_path):
    arguments = ("--scene", "setup", "--cameras", "3", "--fps", "5", "--address", free_first_address(3))
    lenses, rig = tmp_path / "lenses", tmp_path / "rig.yaml"
    with StudioProcess(tmp_path / "studio", *arguments) as studio:
        boards = {name: studio.folder / f"{name}.yaml" for name in ("board", "floor_board")}
        with Graph(tmp_path / "cameras.log", "--cameras", studio.cameras):
            studio.ask("show", phase="intrinsics")
            with ThreadPoolExecutor(len(CAMERAS)) as pool:  # each has a board of its own in front of it
                list(pool.map(lambda name: calibrate_lens(name, boards["board"], lenses), CAMERAS))
            studio.ask("show", phase="floor")
            given = ("--intrinsics", lenses, "--board", boards["floor_board"], "--output", rig)
            run("calibrate", "extrinsics", "--live", "--cameras", *CAMERAS, *given)
            studio.ask("show", phase="empty")
            run("background", "--countdown", "0", "--expect", "3", "--wait", "30")
        truth, T_world_floor = load_rig(studio.folder / "truth_rig.yaml"), read_truth_floor(studio.folder)
        for camera in camera_errors(load_rig(rig), truth, T_world_floor):
            assert camera.focal_percent < 0.5 and camera.principal_px < 3.0
            assert camera.centre_mm < 25.0 and camera.rotation_deg < 0.5
        found_world = person_live(studio, rig, tmp_path)
    body = Body.from_stature(1.75)
    t_pose = forward(body, MOTIONS["tour"](body, 20.0, 60.0).poses[0])
    points = found_world @ T_world_floor[:3, :3].T + T_world_floor[:3, 3]
    assert np.linalg.norm(points - t_pose, axis=1).mean() < 0.08


# --- four webcams, from nothing to a tracked person, by the commands of docs/tutorials/first_capture.md

RATE_HZ, FILM_HZ, FILM_S = 10.0, 60.0, 6.0  # the film is seen in slow motion, so that a busy machine keeps up
PHASE_MS = 20.0  # from one camera to the next: nobody triggers them
SETS, PATIENCE_S = 60, 120.0
UNSYNCHRONISED = ("--set", "hull_server.tolerance_s=0.09", "--set", "hull_server.deadline_s=0.3")


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Path:
    """What is filmed with the webcams: a board before each lens, on the floor, carried about; then somebody."""
    folder = tmp_path_factory.mktemp("webcams") / "room"
    plan = FootagePlan(brief=True, moving_s=10.0)
    return write_setup(folder, ring(4, ceiling=False), plan, motion="tour", seconds=FILM_S)


def write_cameras(folder: Path, rig: Path, session: Path) -> Path:
    """A parameter file a camera, as `sagoma up --cameras` takes them."""
    folder.mkdir()
    for k, name in enumerate(load_rig(rig).names):
        options = [f"folder={session}", f"name={name}", f"rate_hz={RATE_HZ}", f"phase_ms={k * PHASE_MS}"]
        parameters = {
            "rig_file": str(rig),
            "camera_name": name,
            "source": "plugin",
            "plugin": {"source": "film_webcam:FilmWebcam", "options": options},
            "background_file": str(folder / f"{name}.npz"),
        }
        save_mapping(folder / f"{name}.yaml", {f"/{name}/camera_client": {"ros__parameters": parameters}})
    return folder


@pytest.mark.slow
def test_webcams_without_a_trigger_are_set_up_and_a_person_is_tracked(filmed, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(film_webcam.__file__).parent), prepend=":")
    lenses, rig, bag = tmp_path / "lenses", tmp_path / "rig.yaml", tmp_path / "bag"
    run("calibrate", "intrinsics", filmed / "intrinsics", "--board", filmed / "board.yaml", "--output", lenses)
    given = ("--intrinsics", lenses, "--board", filmed / "floor_board.yaml", "--output", rig)
    run("calibrate", "extrinsics", *given, "--floor", filmed / "floor", "--moving", filmed / "moving")
    T_world_floor = read_truth_floor(filmed)
    for camera in camera_errors(load_rig(rig), load_rig(filmed / "truth_rig.yaml"), T_world_floor):
        assert camera.focal_percent < 0.2 and camera.principal_px < 1.5
        assert camera.centre_mm < 8.0 and camera.rotation_deg < 0.2
    cameras = write_cameras(tmp_path / "cameras", rig, filmed / "session")
    words = ("--rig", rig, "--cameras", cameras, "--record", bag, *UNSYNCHRONISED)
    with RosLink("listener") as link, Graph(tmp_path / "up.log", *words) as graph:
        assert graph.active.wait(PATIENCE_S), graph.log.read_text()
        poses = Heard(link.node, JointState, "/mocap/joint_states", PATIENCE_S)
        run("background", "--countdown", "0", "--expect", "4", "--wait", "60")
        began_s = let_in(filmed / "session", 2.0)
        assert poses.wait_for_more(SETS), graph.log.read_text()
    track = tracks_from_bag(bag, lambda stamp_ns: round((1e-9 * stamp_ns - began_s) * RATE_HZ))[1]
    body = Body.from_stature(1.75)
    motion = MOTIONS["tour"](body, FILM_S, FILM_HZ)
    shown = (track.frames >= 0) & (track.frames < len(motion.poses))
    truth = np.stack([forward(body, motion.poses[frame]) for frame in track.frames[shown]])
    points = track.points_world[shown] @ T_world_floor[:3, :3].T + T_world_floor[:3, 3]
    errors = np.linalg.norm(points - truth, axis=2)
    assert len(errors) >= SETS // 2
    assert errors.mean() < 0.03
    assert (errors.max(axis=1) > 0.2).mean() < 0.02
