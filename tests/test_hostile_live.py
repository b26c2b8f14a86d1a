"""A running graph under hostile messages: nothing dies, tracking goes on, and what was refused is counted."""

import os
import time
from pathlib import Path

import pytest
from hostile import Attacker, running_graph
from hostile_messages import attacks

TELLING = {
    "cut in the middle": "bad_images",
    "stamp in 100 years": "ahead_stamps",
    "picture bomb": "bad_images",
    "a cloud of a million points": "large_messages",
    "a cloud of NaN": "dropped_points",
    "YAML bomb": "bad_body",
}
"""Attacks, and a counter each that tells of it."""


@pytest.mark.slow
def test_the_graph_tracks_on_under_hostile_messages_and_counts_them(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with running_graph(tmp_path, int(os.environ["ROS_DOMAIN_ID"])) as target:
        attacker = Attacker(target)
        for attack in attacks(time.time_ns):
            if attack.name in TELLING:
                effect = attacker.send(attack)
                assert effect.died == () and effect.recovered_s == effect.recovered_s, f"{attack.name}: no answers"
                assert any(TELLING[attack.name] in key for key in effect.counted), f"{attack.name}: {effect.counted}"
        effect = attacker.call()
        assert effect.died == () and effect.recovered_s == effect.recovered_s
    strangers = [path for path in tmp_path.parent.rglob("sagoma_was_here*")] + list(
        Path("/tmp").glob("sagoma_was_here*")
    )
    assert strangers == [] and not (Path.home() / "sagoma_was_here").exists()
