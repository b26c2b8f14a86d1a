"""How findings are shown, counted and turned into an exit status."""

import io
from dataclasses import replace

import pytest

from sagoma_tools.console import CommandConsole
from sagoma_tools.doctor.findings import error, exit_status, note, ok, show, summary, warning


def on(subject, findings):
    return [replace(finding, subject=subject) for finding in findings]


FINDINGS = [
    *on("this machine", [ok("disk", "is large"), warning("clock.off", "is off", "chrony"), ok("memory", "is there")]),
    *on(
        "camera cam01",
        [ok("lens", "f 468 px"), note("report.missing", "none"), error("place.below_floor", "below the floor", "redo")],
    ),
    *on("graph", [error("nodes.none", "no node is heard", "start the graph")]),
]


def shown(findings, **options):
    sink = io.StringIO()
    show(findings, CommandConsole(file=sink), **options)
    return sink.getvalue()


def test_findings_are_grouped_by_subject_the_gravest_of_each_first_and_cameras_last():
    lines = shown(FINDINGS).splitlines()
    assert [line for line in lines if line and line[0] != " "][:3] == ["this machine", "graph", "camera cam01"]
    about_cam01 = lines[lines.index("camera cam01") + 1 :]
    assert [line.split()[0] for line in about_cam01[:4]] == ["ERROR", "->", "note", "ok"]


def test_what_is_well_is_one_line_a_group_unless_all_is_asked_for_and_the_last_one_counts():
    *lines, last = shown(FINDINGS).splitlines()
    assert "ok      disk, memory" in "\n".join(lines) and "is large" not in shown(FINDINGS)
    assert "is large" in shown(FINDINGS, all_of_them=True)
    assert last == "2 errors, 1 warning; first: camera cam01: below the floor"
    assert summary([ok("a", ""), note("b", "")]) == "no errors, no warnings (1 check passed)"
    text = "a long way " * 40 + "home"  # not broken in a file, whatever its length
    assert text in shown([warning("way", text, "walk")])


@pytest.mark.parametrize(
    "findings, strict, status",
    [
        ([note("a", "")], True, 0),
        ([warning("a", "", "do")], False, 1),
        ([warning("a", "", "do")], True, 2),
        ([error("a", "", "do")], False, 2),
    ],
)
def test_exit_status_of_strict_and_lenient_users(findings, strict, status):
    assert exit_status(findings, strict) == status
