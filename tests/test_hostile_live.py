"""A running graph under hostile messages: nothing dies, tracking goes on, and what was refused is counted."""

import os
import time
from pathlib import Path

import pytest
from hostile import Attacker, running_graph
from hostile_messages import attacks

TRIES = 3  # on a busy machine a message's stamp may be passed when it comes: it is refused for that
COUNTED = {"bad_images", "bad_predictions", "bad_hulls", "bad_keypoints", "bad_rules"}


@pytest.mark.slow
def test_the_graph_tracks_on_under_hostile_messages_and_counts_them(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with running_graph(tmp_path, int(os.environ["ROS_DOMAIN_ID"])) as target:
        attacker = Attacker(target)
        for _ in range(TRIES):
            for attack in attacks(time.time_ns):
                attacker.send(attack)
            if told := target.tells(COUNTED):
                break
        assert told
        attacker.call()
    written = [*tmp_path.parent.rglob("sagoma_was_here*"), *Path("/tmp").glob("sagoma_was_here*")]
    assert written == [] and not (Path.home() / "sagoma_was_here").exists()
