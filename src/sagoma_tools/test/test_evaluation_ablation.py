"""The rows of the ablation, and tracks of several configurations over the same hulls."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np

from capture_rig.session import Session
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline, TrackingStage
from mocap_pipeline.session_footage import exact_silhouettes
from sagoma_bringup.launch_arguments import start_settings
from sagoma_tools.evaluation.in_process import OURS, PARTS, ROWS, THESIS, ablation_rows, track_people, track_session


def started(session: Session, **changes) -> Configuration:
    settings = {**start_settings(session, "session"), "hull_server.backend": "cpu"}
    return replace(Configuration.of(settings), **changes)


def differing(a, b, prefix="") -> set[str]:
    """Dotted names of the settings in which two configurations differ."""
    if type(a) is not type(b) or not hasattr(a, "__dataclass_fields__"):
        return set() if a == b else {prefix}
    found = [differing(getattr(a, f.name), getattr(b, f.name), f"{prefix}.{f.name}".lstrip(".")) for f in fields(a)]
    return set().union(*found)


def test_the_last_row_is_the_settings_own_and_the_first_the_thesis_method():
    settings = {"icp_tracker.refinement.keyframes": 20}
    rows = ablation_rows(settings)
    assert tuple(rows) == ROWS
    assert differing(rows[OURS], Configuration.of(settings)) == set()
    first = rows[THESIS]
    assert (first.icp.method, first.ekf.motion_model, first.feedback) == ("hierarchical", "identity", False)
    assert first.icp.refinement.keyframes == 20


def test_every_row_adds_exactly_one_part():
    for (before, after), without in zip(pairwise(ablation_rows({}).values()), PARTS.values(), strict=True):
        switched = {key.replace("icp_tracker.", "icp.").replace("ekf_tracker.", "ekf.") for key in without}
        assert differing(before, after) == switched


def test_a_configuration_tracks_the_same_alone_and_beside_others_which_share_one_carving(toured, monkeypatch):
    alone = track_session(toured, started(toured), exact_masks=True)
    carved = []
    carve = MocapPipeline.carve_set
    monkeypatch.setattr(MocapPipeline, "carve_set", lambda *args: carved.append(args[1].stamp_ns) or carve(*args))
    both = {"a": started(toured), "b": started(toured, feedback=False)}
    beside = {name: people[1] for name, people in track_people(toured, both, exact_masks=True).items()}
    assert len(carved) == len(set(carved)) == 12
    assert alone.points_world.tobytes() == beside["a"].points_world.tobytes()
    assert not np.array_equal(beside["a"].points_world, beside["b"].points_world)


def test_without_feedback_every_fit_starts_from_the_fit_before(toured):
    graph = MocapPipeline(toured.rig, started(toured))
    closed, opened = graph.body, TrackingStage.of(started(toured, feedback=False))
    starts: dict[str, list[str]] = {"closed": [], "opened": []}
    for frame, masks in enumerate(exact_silhouettes(toured)):
        clouds = graph.carve(1_000_000_000 + 50_000_000 * frame, masks)
        starts["closed"].append(closed.step(clouds).fit.started_from)
        starts["opened"].append(opened.step(clouds).fit.started_from)
    assert starts["opened"][1:] == ["own"] * 11
    assert starts["closed"][1] == "1000000000"
    assert "own" not in starts["closed"]
