"""A running graph under hostile messages: nothing dies, tracking goes on, and what was refused is counted."""

import math
import os
import re
import time
from pathlib import Path

import pytest
from hostile import Attacker, running_graph
from hostile_messages import Attack, attacks

TELLING = {
    "cut in the middle": "bad_images",
    "stamp in 100 years": "frames_(ahead|backwards)",  # of one camera; of most, a new beginning
    "NaN": "bad_predictions",
    "a million elements": "bad_hulls",
    "picture bomb": "bad_images",
    "wrong encoding": "bad_images",
    "a cloud of NaN": "bad_keypoints",
    "YAML bomb": "bad_rules",
}
"""Attacks, and the counter (a pattern) that tells of each. Others are survived: clouds that only strangers subscribe
to, and texts that mean nothing."""
TRIES = 3  # on a busy machine a message's stamp may be passed when it comes: it is refused for that


def told(attack: Attack, keys: set[str]) -> bool:
    return attack.name not in TELLING or any(re.search(TELLING[attack.name], key) for key in keys)


def counted(attacker: Attacker, attack: Attack) -> set[str]:
    """Send an attack that the graph survives, until its own counter tells of it; all that was counted."""
    keys: set[str] = set()
    for _ in range(TRIES):
        effect = attacker.send(attack)
        assert effect.died == () and math.isfinite(effect.recovered_s), f"{attack.name}: {effect}"
        keys |= set(effect.counted)
        if told(attack, keys):
            break
    return keys


@pytest.mark.slow
def test_the_graph_tracks_on_under_hostile_messages_and_counts_them(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with running_graph(tmp_path, int(os.environ["ROS_DOMAIN_ID"])) as target:
        attacker = Attacker(target)
        for attack in attacks(time.time_ns):
            keys = counted(attacker, attack)
            assert told(attack, keys), f"{attack.name}: {keys}"
        effect = attacker.call()
        assert effect.died == () and math.isfinite(effect.recovered_s)
    strangers = [path for path in tmp_path.parent.rglob("sagoma_was_here*")] + list(
        Path("/tmp").glob("sagoma_was_here*")
    )
    assert strangers == [] and not (Path.home() / "sagoma_was_here").exists()
