"""Several persons through the whole pipeline, on exact silhouettes of the virtual studio."""

import numpy as np
import pytest

from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from stick_figure.kinematics import forward
from virtual_studio.motions.together import TOGETHER
from virtual_studio.people import people_of_sizes, together
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

FPS = 30.0


@pytest.mark.slow
def test_two_who_pass_shake_hands_hug_and_part_are_followed_without_being_exchanged():
    rig, persons = ring(5), people_of_sizes(2)
    motions, eyes = TOGETHER["meeting"].motions(persons, FPS), ExactSilhouettes(rig)
    pipeline = MocapPipeline(rig, Configuration.of({"hull_server.backend": "cpu"}))
    errors: dict[int, list[np.ndarray]] = {1: [], 2: []}  # mm from each of the two, by the tracker's number
    for frame, poses in enumerate(zip(*(motion.poses for motion in motions), strict=True)):
        masks = eyes.render(together(*(person.place(pose) for person, pose in zip(persons, poses, strict=True))))
        true = [forward(person.body, pose) for person, pose in zip(persons, poses, strict=True)]
        for person in pipeline.step_masks(round((frame + 1) * 1e9 / FPS), masks).people:
            if person.state is not None:
                off = [np.linalg.norm(person.state.points_world - points, axis=1).mean() for points in true]
                errors[person.person].append(1e3 * np.array(off))
    for rows in errors.values():
        from_each = np.array(rows)
        assert len(from_each) > 0.95 * len(motions[0].poses)
        assert len(set(from_each.argmin(axis=1))) == 1  # always the same one
        assert from_each.min(axis=1).mean() < 25.0
    assert {int(np.argmin(rows[0])) for rows in errors.values()} == {0, 1}
