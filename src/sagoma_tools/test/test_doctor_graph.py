"""What the doctor concludes of a made-up graph, and of a real one of fake nodes with faults in them, to which it
listens."""

import json
from dataclasses import replace

import pytest
from doctor_fake_nodes import RIG, FakeCamera, fake_server
from tools_waiting import settled_at

from camera_client.background.causes import find_causes, findings_text, unfit
from camera_client.background.model import Provenance
from camera_client.background.training import TrainingReport
from camera_client.condition import Condition
from camera_client.diagnostics import UNCALIBRATED
from capture_rig.rig import save_rig
from capture_rig.verdict import Finding
from sagoma_tools.cli import main
from sagoma_tools.doctor.findings import Severity
from sagoma_tools.doctor.graph import graph_findings
from sagoma_tools.doctor.graph_listener import GraphFacts, NodeFacts, SilhouetteFacts, collect_graph
from sagoma_tools.graph.diagnostics_table import NodeReport


def node(name):
    return NodeFacts(name, "active", 1, NodeReport(b"\0", "running", lead_s=-3e-4))


def reporting(node, **changes):
    """The node with changes of its last report."""
    return replace(node, report=replace(node.report, **changes))


def silhouettes(camera, **changes):
    return replace(SilhouetteFacts(camera, 60, share=0.05, age_s=0.02), **changes)


HULL, ICP, EKF = node("/hull_server"), node("/icp_tracker"), node("/ekf_tracker")
CLIENTS = {name: node(f"/{name}/camera_client") for name in RIG.names}
SENT = {name: silhouettes(name) for name in RIG.names}
SET = {"spread_ms": "2.0", "published_ms": "40.0", "points": "30"}
SETS = (SET,) * 60


def graph(changed=(), sent=(), **changes):
    """The healthy graph with some nodes and cameras, or parts of the facts, replaced."""
    all_nodes = {n.name: n for n in (HULL, ICP, EKF, *CLIENTS.values(), *changed)}
    all_cameras = {**SENT, **{c.camera: c for c in sent}}
    facts = GraphFacts(46, tuple(all_nodes.values()), tuple(all_cameras.values()), SETS, 10.0, expected=RIG.names)
    return replace(facts, **changes)


def without(node, facts):
    return replace(facts, nodes=tuple(one for one in facts.nodes if one is not node))


def troubles(facts):
    """(severity, subject, code, what) of all that is worse than a note; each has a remedy."""
    found = [finding for finding in graph_findings(facts) if finding.severity >= Severity.WARNING]
    assert all(finding.remedy for finding in found)
    return [(finding.severity.name, finding.subject, finding.code, finding.what) for finding in found]


def trained(grade, *findings):
    """cam02's client with the report of a training."""
    return reporting(C2, values={"background_training": TrainingReport(1, grade, findings).to_json()})


C2, MOVED = CLIENTS["cam02"], ("something moved: in the middle", "clear the scene")


def test_healthy_graph_and_one_of_an_empty_room_have_no_troubles():
    for well in ([], [trained("good")], [trained("usable", Finding("usable", *MOVED))]):
        assert troubles(graph(well)) == []
    empty = [silhouettes(name, share=0.0) for name in RIG.names]
    say = [reporting(CLIENTS[name], level=b"\1", message="the mask is empty") for name in RIG.names]
    say += [reporting(HULL, level=b"\1", message="the hull is empty")]
    say += [reporting(ICP, level=b"\1", message="acquiring: no hull")]
    assert troubles(graph(say, empty, sets=({**SET, "points": "0"},) * 60)) == []


OF_THE_NODE = [
    (trained("redo", Finding("redo", *MOVED)), "WARNING", "background.failed", "in the middle (clear the scene)"),
    (replace(C2, state=None, report=None), "ERROR", "node.silent", ""),
    (replace(C2, state=None), "ERROR", "node.silent", "does not answer:"),
    (replace(C2, report=None), "ERROR", "diagnostics.missing", ""),
    (replace(C2, state="inactive"), "WARNING", "state.inactive", ""),
    (replace(C2, copies=2), "ERROR", "node.duplicate", "2 nodes call themselves /cam02/camera_client"),
    (reporting(C2, level=b"\2", message="no camera: it is off"), "ERROR", "says.error", "no camera: it is off"),
    (reporting(C2, level=b"\1", message="the mask is full"), "WARNING", "says.warning", "the mask is full"),
    (reporting(C2, lead_s=0.4997), "ERROR", "clock.off", "499.7 ms ahead"),
    (reporting(C2, lead_s=-0.5012), "ERROR", "clock.off", "501.2 ms behind"),
    (reporting(C2, lead_s=0.029), "WARNING", "clock.imprecise", "29.0 ms ahead"),
]
OF_ITS_SILHOUETTES = [
    ({"masks": 0, "share": 0.0}, "ERROR", "silhouettes.not_arriving", "none arrives"),
    ({"share": 0.0}, "WARNING", "silhouettes.blank", "cam01, cam03"),
    ({"share": 0.7}, "ERROR", "silhouettes.flooded", "70.0 %"),
    ({"lost": 30}, "WARNING", "network.loss", "30 of 90 silhouettes"),
    ({"age_s": -0.4}, "ERROR", "stamps.ahead", "0.400 s"),
    ({"age_s": 3.0}, "WARNING", "latency.old", "3.0 s"),
]
SENDING = reporting(C2, values={"rate_hz": "10.0"})
BARE = reporting(C2, level=b"\1", message=UNCALIBRATED)
RATES = zip(CLIENTS.values(), ("60", "30", "60"), strict=True)
SLOW = [reporting(client, values={"frame_rate": rate}) for client, rate in RATES]
CAMERA, GRAPH = "camera cam02", "graph"
OF_THE_GRAPH = [
    (graph([SENDING], [silhouettes("cam02", masks=0)]), CAMERA, "ERROR", "silhouettes.not_arriving", "10.0 a second"),
    (graph([BARE], [silhouettes("cam02", masks=0, share=0.0)]), CAMERA, "WARNING", "says.warning", UNCALIBRATED),
    (graph(sets=()), GRAPH, "ERROR", "frame_sets.none", ""),
    (graph(sets=({**SET, "spread_ms": "40.0"},) * 60), GRAPH, "WARNING", "sync.spread", "40.0 ms, of a frame"),
    (graph(sets=({**SET, "published_ms": "900.0"},) * 60), GRAPH, "WARNING", "latency.late", "900 ms"),
    (graph(sets=({**SET, "points": "0"},) * 60), GRAPH, "ERROR", "centerline.empty", "3 cameras"),
    (graph(sets=({**SET, "missing": "cam02"}, SET) * 30), CAMERA, "WARNING", "frame_sets.missing_camera", "30 of 60"),
    (graph(SLOW), GRAPH, "WARNING", "settings.frame_rate_differs", "cam01 60, cam02 30, cam03 60"),
    (without(ICP, graph()), GRAPH, "ERROR", "nodes.server_missing", "ROS_DOMAIN_ID 46: /icp_tracker"),
    (without(C2, graph([], [SilhouetteFacts("cam02")])), CAMERA, "ERROR", "node.missing", ""),
    (graph([], [SilhouetteFacts("cam77", masks=5, share=0.05)]), GRAPH, "WARNING", "cameras.not_in_rig", "cam77"),
]


@pytest.mark.parametrize(
    "facts, subject, severity, code, value",
    [
        *((graph([node]), CAMERA, *expected) for node, *expected in OF_THE_NODE),
        *(
            (graph([], [silhouettes("cam02", **changes)]), CAMERA, *expected)
            for changes, *expected in OF_ITS_SILHOUETTES
        ),
        *OF_THE_GRAPH,
    ],
)
def test_what_is_wrong_is_named_where_it_is(facts, subject, severity, code, value):
    (found,) = troubles(facts)
    assert found[:3] == (severity, subject, code) and value in found[3]


def test_nobody_heard_says_where_nodes_are(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr("sagoma_tools.doctor.graph.domains_here", lambda: (7, 46))
    finding = next(iter(graph_findings(GraphFacts(46, expected=RIG.names))))
    assert (finding.severity, finding.code) == (Severity.ERROR, "nodes.none")
    assert "(7)" in finding.remedy and "LOCALHOST" in finding.remedy


REFUSED = unfit(Provenance("camera", 100, 1.5, camera_serial="S1"), {"camera_serial": "S2"})
(CAUSE,) = find_causes(Condition(light_gain=1.4).figures())
(SLIGHT,) = find_causes(Condition(light_gain=1.12).figures())


@pytest.mark.parametrize(
    "told, severity, code, value",
    [
        (REFUSED, "ERROR", "background.other_camera", "S2"),
        (CAUSE, "WARNING", "light.level", "the light has changed by +40 %"),
        (SLIGHT, "NOTE", "light.level", "+12 %"),
    ],
)
def test_cause_that_a_client_names_is_told_once_with_its_code_and_remedy(told, severity, code, value):
    says = {} if severity == "NOTE" else {"level": b"\1", "message": told.line}
    client = reporting(C2, values={"findings": findings_text([told])}, **says)
    named = [each for each in graph_findings(graph([client])) if each.severity > Severity.OK]
    assert [(each.severity.name, each.subject, each.code) for each in named] == [(severity, "camera cam02", code)]
    assert all(value in each.what and each.remedy for each in named)


# --- a real graph

DOMAIN, ELSEWHERE = 93, 94  # of this file alone: nobody else's nodes are heard


@pytest.fixture(scope="module")
def heard():
    """cam01 is well, cam02 blank and its clock half a second ahead; cam03 is not there."""
    there = FakeCamera("cam01", domain_id=DOMAIN), FakeCamera("cam02", blank=True, lead_s=0.5, domain_id=DOMAIN)
    with fake_server(DOMAIN), there[0], there[1]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("sagoma_tools.doctor.graph_listener.settled", settled_at(5))
            found = collect_graph(1.0, RIG.names, DOMAIN)
        yield found


def test_real_nodes_are_heard_with_state_silhouettes_and_clock_and_what_is_wrong_with_them_is_found(heard):
    clients = {"/cam01/camera_client", "/cam02/camera_client"}
    assert {node.name for node in heard.nodes} == clients | {"/hull_server", "/icp_tracker", "/ekf_tracker"}
    assert {(node.state, node.copies) for node in heard.nodes} == {("active", 1)}
    assert heard.node("/cam02/camera_client").report.lead_s == pytest.approx(0.5, abs=0.1)
    well, blank, absent = heard.cameras
    assert well.masks > 3 and well.lost == 0
    canvas = RIG.camera("cam01").undistorted_view().camera  # of which 80 x 300 pixels are somebody
    assert well.share == pytest.approx(80 * 300 / (canvas.width * canvas.height))
    assert (blank.share, absent.masks) == (0.0, 0)
    found = {(finding.subject, finding.code) for finding in graph_findings(heard)}
    assert found >= {("camera cam01", "clock.ok"), ("camera cam01", "silhouettes.ok"), ("camera cam03", "node.missing")}
    assert found >= {("camera cam02", code) for code in ("clock.off", "stamps.ahead", "silhouettes.blank")}


@pytest.mark.slow
def test_another_domain_is_empty_and_the_command_says_where_nodes_are(heard, tmp_path, capsys, monkeypatch):
    save_rig(RIG, tmp_path / "rig.yaml")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ELSEWHERE))
    arguments = ["doctor", "--no-machine", "--live", "--seconds", "0.1", "--json", "--rig", str(tmp_path / "rig.yaml")]
    assert main(arguments) == 2
    findings = json.loads(capsys.readouterr().out)["findings"]
    (nobody,) = [finding for finding in findings if finding["subject"] == "graph"]
    assert nobody["code"] == "nodes.none" and str(ELSEWHERE) in nobody["what"] and str(DOMAIN) in nobody["remedy"]
