"""Unknown cameras of the virtual studio are set up by the commands that a user gives; the truth only scores."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from command_line import Graph, run

from capture_rig.rig import load_rig
from sagoma_bringup.graph import build_graph
from sagoma_tools.evaluation.live_inputs import StudioProcess, free_first_address
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.graph.supervisor import Supervisor
from sagoma_tools.recording.recorder import GraphRecorder
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.recording.footage import camera_errors, read_truth_floor

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
