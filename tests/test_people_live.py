"""Two persons through the server's nodes: recorded silhouettes in, a bag with everybody out, one process or three."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from silhouette_bag import EPOCH_NS, write_silhouette_bag

from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from sagoma_bringup.graph import SERVER_LAYOUTS
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.recording.reader import bag_digest
from sagoma_tools.recording.replayer import replay_through_graph
from stick_figure.body import Body
from virtual_studio.motions.together import TOGETHER
from virtual_studio.people import VolumetricBody, together
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

pytestmark = pytest.mark.slow

FPS, TOGETHER_S, ALONE_S = 20.0, 2.0, 1.5
RIG = ring(4, True)
PERSONS = [VolumetricBody(Body.from_stature(1.75)), VolumetricBody(Body.from_stature(1.65))]
SETTINGS = {"hull_server.backend": "cpu"}
BESIDE = "/mocap/bodies/b0002"


@pytest.fixture(scope="module")
def clip():
    """Silhouettes of both, then of the first one alone."""
    crowd = TOGETHER["crowd"]
    motions = replace(crowd, roles=crowd.roles[:2]).motions(PERSONS, FPS, TOGETHER_S + ALONE_S)
    eyes, both_until = ExactSilhouettes(RIG), round(TOGETHER_S * FPS)
    placed = [[person.place(pose) for pose in motion.poses] for person, motion in zip(PERSONS, motions, strict=True)]
    return [
        eyes.render(together(first, second) if k < both_until else first)
        for k, (first, second) in enumerate(zip(*placed, strict=True))
    ]


@pytest.fixture(scope="module")
def bags(clip, tmp_path_factory) -> list[Path]:
    """The silhouettes through a fresh graph in lockstep, the server in one process and in three."""
    folder = tmp_path_factory.mktemp("people")
    recorded = write_silhouette_bag(folder / "silhouettes", RIG, clip, FPS)
    outputs = [folder / server for server in SERVER_LAYOUTS]
    for output in outputs:
        logs = folder / f"{output.name}_logs"
        report = replay_through_graph(recorded, output, logs, settings=SETTINGS, server=output.name)
        assert report.unanswered_ns == []
    return outputs


def test_one_process_and_three_give_the_same_bytes_of_two_persons(bags):
    one, three = (bag_digest(bag) for bag in bags)
    assert one == three
    assert one[f"{BESIDE}/joint_states"].count > 20


def test_both_persons_are_in_the_bag_with_the_numbers_of_the_page(clip, bags):
    """The pipeline in this process, on the same silhouettes; how near it is to the truth: mocap_pipeline's own test."""
    given = SETTINGS | {"icp_tracker.initial_pose.rig_file": str(bags[0] / "rig.yaml")}
    pipeline = MocapPipeline(RIG, Configuration.of(given))
    angles: dict[int, dict[int, np.ndarray]] = {1: {}, 2: {}}
    for k, masks in enumerate(clip):
        for step in pipeline.step_masks(EPOCH_NS + round(k * 1e9 / FPS), masks).people:
            if step.state is not None and step.state.tracking != "lost":
                angles[step.person][k] = step.state.angles
    tracks = tracks_from_bag(bags[0], lambda stamp_ns: round((stamp_ns - EPOCH_NS) * 1e-9 * FPS))
    assert list(tracks) == [1, 2]
    for person, track in tracks.items():
        assert track.frames.tolist() == list(angles[person])
        np.testing.assert_array_equal(track.angles, list(angles[person].values()))
