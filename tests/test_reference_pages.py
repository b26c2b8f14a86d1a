"""Pages against the code: parameters, topics of the graph, causes of bad silhouettes."""

import re
from pathlib import Path

from reference import SETTINGS, with_lists

from camera_client.background.causes import CAUSES
from capture_rig.settings import leaves
from sagoma_tools.graph.topics import DIAGNOSTICS, OUTPUT_TOPICS, camera_topics

DOCS = Path(__file__).resolve().parents[1] / "docs"
PARAMETERS = (DOCS / "parameters.md").read_text(encoding="utf-8")


def test_the_lists_of_parameters_are_those_of_the_settings():
    assert with_lists(PARAMETERS) == PARAMETERS, "run python scripts/reference.py"
    assert all(f"\n- `{leaf.key}`" in PARAMETERS for settings in SETTINGS.values() for leaf in leaves(settings))


def test_every_topic_of_the_graph_stands_in_its_table_with_its_type_and_whether_it_is_latched():
    rows = [line.split("|") for line in (DOCS / "ros.md").read_text(encoding="utf-8").splitlines() if line[:3] == "| `"]
    table = {name: (row[2].strip(), "latched" in row[-2]) for row in rows for name in re.findall(r"`(/[^`]+)`", row[1])}
    topics = (*OUTPUT_TOPICS, DIAGNOSTICS, *camera_topics("CAM"))
    expected = {topic.name: (topic.msgtype.replace("/msg/", "/"), topic.latched) for topic in topics}
    assert expected.items() <= table.items()


def test_every_cause_of_a_bad_silhouette_that_the_page_names_is_one_that_a_client_finds():
    section = (DOCS / "silhouettes.md").read_text(encoding="utf-8").partition("## Causes of bad silhouettes")[2]
    named = {code for row in re.findall(r"^\| (`.+?) \|", section, re.M) for code in re.findall(r"`(\w+\.\w+)`", row)}
    assert len(named) > 15
    assert named - {cause.code for cause in CAUSES} == {"background.exposure", "background.gain"}  # of the camera
