"""Every file read back by a reader of its own field, points compared with the motion's."""

import csv
import os
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pygltflib as gltf
import pytest
from export_motions import BODY, START_NS, swinging
from scipy.spatial.transform import Rotation, Slerp

from motion_export.animation_files import write_bvh, write_glb
from motion_export.joint_tree import JOINTS, PARENTS
from motion_export.marker_files import write_c3d, write_csv, write_trc
from motion_export.motion import R_ANIMATION_WORLD, R_BIOMECHANICS_WORLD, Motion
from motion_export.opensim import write_mot, write_osim
from stick_figure.body import Body
from stick_figure.skeleton import POINT_NAMES

GAP = (30, 36)
FRAMES = (0, 17, 29, 36, 60, 89)
NEAR_M = 1e-4
"""A tenth of what a reader may be off: files hold at least micrometres, or single precision of some metres."""
POINT_OF_JOINT = {joint.name: POINT_NAMES.index(joint.point) for joint in JOINTS if joint.point is not None}


@pytest.fixture()
def osim() -> ModuleType:
    """OpenSim, without the changes that it makes to the environment of this process and its children when imported."""
    before = dict(os.environ)
    module = pytest.importorskip("opensim", reason="OpenSim is not installed (requirements-dev.txt)")
    os.environ.clear()
    os.environ.update(before)
    module.Logger.setLevelString("error")
    return module


def growing() -> Motion:
    """A take during which the body was refined: bones change by centimetres."""
    bodies = [replace(BODY, half_lengths=BODY.half_lengths * (1.0 + 0.0005 * k)) for k in range(90)]
    return swinging(bodies=bodies)


@pytest.mark.parametrize("motion", [swinging(gap=GAP), growing()], ids=["gap", "growing"])
def test_bvh_read_by_bvhio(motion: Motion, tmp_path: Path) -> None:
    bvhio = pytest.importorskip("bvhio", reason="bvhio, a reader of BVH, is not installed (requirements-dev.txt)")
    write_bvh(motion, tmp_path / "take.bvh")
    root = bvhio.readAsHierarchy(str(tmp_path / "take.bvh"))
    joints = {name: root.filter(name)[0] for name in POINT_OF_JOINT}
    for frame in FRAMES:
        root.loadPose(frame)
        for name, point in POINT_OF_JOINT.items():
            place = R_ANIMATION_WORLD.T @ np.array(joints[name].PositionWorld) / 100.0
            assert place == pytest.approx(motion.points_world[frame, point], abs=NEAR_M)


def test_c3d_read_by_ezc3d(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed (requirements-dev.txt)")
    motion = swinging(gap=GAP)
    write_c3d(motion, tmp_path / "take.c3d")
    read = ezc3d.c3d(str(tmp_path / "take.c3d"))
    header = read["parameters"]["POINT"]
    assert [label.strip() for label in header["LABELS"]["value"]] == list(POINT_NAMES)
    assert header["RATE"]["value"][0] == 60.0 and header["UNITS"]["value"][0].strip() == "mm"
    points = read["data"]["points"][:3].transpose(2, 1, 0) / 1000.0
    assert np.isnan(points[slice(*GAP)]).all()
    tracked = motion.tracked
    assert np.abs(points[tracked] - motion.points_world[tracked]).max() < NEAR_M


def test_c3d_residual_is_the_standard_deviation(tmp_path: Path) -> None:
    import c3d

    write_c3d(swinging(gap=GAP), tmp_path / "take.c3d")
    with (tmp_path / "take.c3d").open("rb") as file:
        residuals = np.array([points[:, 3] for _, points, _ in c3d.Reader(file).read_frames()])
    assert (residuals[slice(*GAP)] == -1).all()
    assert residuals[0, 0] == pytest.approx(5.0, abs=0.5) and residuals[-1, 0] == pytest.approx(20.0, abs=0.5)


def test_trc_read_by_opensim(osim: ModuleType, tmp_path: Path) -> None:
    motion = swinging(gap=(84, 90))  # with a gap whose last cell ends a line
    write_trc(motion, tmp_path / "take.trc")
    table = osim.TimeSeriesTableVec3(str(tmp_path / "take.trc"))
    assert list(table.getColumnLabels()) == list(POINT_NAMES) and table.getNumRows() == len(motion)
    for frame in (0, 40):
        row = table.getRowAtIndex(frame)
        places = np.array([[row[point][k] for k in range(3)] for point in range(15)]) / 1000.0
        assert np.abs(places @ R_BIOMECHANICS_WORLD - motion.points_world[frame]).max() < NEAR_M


def test_opensim_model_moves_its_markers_like_the_points(osim: ModuleType, tmp_path: Path) -> None:
    motion = swinging(gap=GAP)
    write_osim(motion, tmp_path / "take.osim", mass_kg=70.0)
    write_mot(motion, tmp_path / "take.mot")
    model, table = osim.Model(str(tmp_path / "take.osim")), osim.TimeSeriesTable(str(tmp_path / "take.mot"))
    state, coordinates = model.initSystem(), model.getCoordinateSet()
    assert table.getTableMetaDataString("inDegrees") == "yes" and table.getNumRows() == len(motion)
    assert model.getTotalMass(state) == pytest.approx(70.0)
    for frame in FRAMES:
        for name, value in zip(table.getColumnLabels(), table.getRowAtIndex(frame).to_numpy(), strict=True):
            coordinate = coordinates.get(name)
            rotational = coordinate.getMotionType() == osim.Coordinate.Rotational
            coordinate.setValue(state, np.deg2rad(value) if rotational else value, False)
        model.realizePosition(state)
        for point, name in enumerate(POINT_NAMES):
            place = model.getMarkerSet().get(name).getLocationInGround(state)
            ours = R_BIOMECHANICS_WORLD @ motion.points_world[frame, point]
            assert [place[k] for k in range(3)] == pytest.approx(ours, abs=NEAR_M)


@pytest.mark.parametrize("motion", [swinging(gap=GAP), growing()], ids=["gap", "growing"])
def test_glb_keys_give_the_points(motion: Motion, tmp_path: Path) -> None:
    """By the specification's own rules: accessors, linear keys, nodes under nodes."""
    write_glb(motion, tmp_path / "take.glb")
    document = gltf.GLTF2().load(str(tmp_path / "take.glb"))
    (animation,) = document.animations
    assert animation.extras.get("gaps_s", []) == [[a / 60.0, b / 60.0] for a, b in motion.gaps]
    for frame in FRAMES:
        local = [vars(node).copy() for node in document.nodes]
        for channel in animation.channels:
            sampler, target = animation.samplers[channel.sampler], channel.target
            times, values = accessor(document, sampler.input), accessor(document, sampler.output)
            local[target.node][target.path] = sample(times, values, frame / 60.0, target.path)
        places = {joint.name: place for joint, place in zip(JOINTS, joint_places(local), strict=True)}
        for name, point in POINT_OF_JOINT.items():
            assert R_ANIMATION_WORLD.T @ places[name] == pytest.approx(motion.points_world[frame, point], abs=NEAR_M)


def test_glb_read_by_trimesh_shows_bones_in_the_first_pose(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed (requirements-dev.txt)")
    motion = swinging()
    write_glb(motion, tmp_path / "take.glb")
    scene = trimesh.load(str(tmp_path / "take.glb"))
    assert len(scene.graph.nodes_geometry) == len(JOINTS) - 1
    for name, point in POINT_OF_JOINT.items():
        place = scene.graph.get(name)[0][:3, 3]
        assert R_ANIMATION_WORLD.T @ place == pytest.approx(motion.points_world[0, point], abs=NEAR_M)


def test_csv_holds_points_covariances_angles_and_states(tmp_path: Path) -> None:
    motion = swinging(gap=GAP)
    write_csv(motion, tmp_path / "take.csv")
    with (tmp_path / "take.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(motion)
    assert rows[30]["state"] == "" and rows[30]["head_x_m"] == ""
    assert int(rows[0]["stamp_ns"]) == START_NS
    for frame in (0, 89):
        row = rows[frame]
        assert [float(row[f"left_hand_{a}_m"]) for a in "xyz"] == pytest.approx(motion.points_world[frame, 11])
        assert float(row["neck_cov_yy_m2"]) == pytest.approx(motion.covariance[frame, 2, 1, 1])
        assert float(row["right_knee_rad"]) == pytest.approx(motion.angles[frame, 15])
        assert float(row["isb_right_knee_flexion_deg"]) == pytest.approx(np.rad2deg(motion.angles[frame, 15]))


def test_sizes_of_the_model_are_the_persons(tmp_path: Path) -> None:
    write_osim(swinging(), tmp_path / "take.osim")
    text = (tmp_path / "take.osim").read_text()
    mass = sum(float(part.split("<")[0]) for part in text.split("<mass>")[1:])
    assert mass == pytest.approx(22.0 * Body.from_points(swinging().points_world).stature ** 2, rel=1e-4)


def accessor(document: gltf.GLTF2, number: int) -> np.ndarray:
    description = document.accessors[number]
    assert description.componentType == gltf.FLOAT
    width, offset = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[description.type], description.byteOffset or 0
    offset += document.bufferViews[description.bufferView].byteOffset
    values = np.frombuffer(document.binary_blob(), "<f4", description.count * width, offset)
    return values.reshape(-1, width).astype(float)


def sample(times: np.ndarray, values: np.ndarray, time_s: float, path: str) -> np.ndarray:
    if path == "rotation":
        return Slerp(times[:, 0], Rotation.from_quat(values))(time_s).as_quat()
    return np.array([np.interp(time_s, times[:, 0], column) for column in values.T])


def joint_places(local: list[dict]) -> list[np.ndarray]:
    """World positions of the joints' nodes, which come first and in their order."""
    world: list[tuple[np.ndarray, np.ndarray]] = []
    for joint, parent in enumerate(PARENTS):
        R = Rotation.from_quat(local[joint]["rotation"]).as_matrix()
        t = np.array(local[joint]["translation"])
        if parent >= 0:
            R_parent, t_parent = world[parent]
            R, t = R_parent @ R, R_parent @ t + t_parent
        world.append((R, t))
    return [t for _, t in world]
