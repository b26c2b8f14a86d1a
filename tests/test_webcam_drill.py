"""Four webcams, from nothing to a tracked person, by the commands of docs/first_capture.md; the truth only scores."""

from pathlib import Path

import film_webcam
import numpy as np
import pytest
from command_line import Graph, calibrated, run
from film_webcam import let_in
from heard import Heard
from sensor_msgs.msg import JointState

from capture_rig.rig import load_rig
from capture_rig.yaml_file import save_mapping
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.graph.ros_link import RosLink
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.recording.footage import FootagePlan, camera_errors, read_truth_floor, write_setup
from virtual_studio.rig import ring

RATE_HZ, FILM_HZ, FILM_S = 10.0, 60.0, 6.0  # the film is seen in slow motion, so that a busy machine keeps up
PHASE_MS = 20.0  # from one camera to the next: nobody triggers them
SETS, PATIENCE_S = 60, 120.0
UNSYNCHRONISED = ("--set", "hull_server.tolerance_s=0.09", "--set", "hull_server.deadline_s=0.3")


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Path:
    """What is filmed with the webcams: a board before each lens, on the floor, carried about; then somebody."""
    folder = tmp_path_factory.mktemp("webcams") / "room"
    plan = FootagePlan(stills=True, brief=True, fps=2.0, moving_s=10.0)
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
    rig, bag, T_world_floor = calibrated(filmed, tmp_path), tmp_path / "bag", read_truth_floor(filmed)
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
