"""The line below the live table: how old frame sets are, against the budget."""

from diagnostic_msgs.msg import DiagnosticStatus

from sagoma_tools.graph.diagnostics_table import NodeReport, latency_line


def report(**values):
    return NodeReport(DiagnosticStatus.OK, "", values)


def test_line_says_ages_and_whether_they_keep_the_budget():
    reports = {
        "/hull_server": report(latency_p50_ms="15.10"),
        "/icp_tracker": report(latency_p50_ms="20.30"),
        "/ekf_tracker": report(latency_p50_ms="21.00", latency_p95_ms="24.00", rate_hz="60.0"),
    }
    line = latency_line(reports)
    assert "hull 15.10 ms, fit 20.30 ms, joint state 21.00 ms" in line
    assert "24 ms: 1.4 periods, within" in line
    reports["/ekf_tracker"] = report(latency_p50_ms="21.00", latency_p95_ms="40.00", rate_hz="60.0")
    assert "2.4 periods, over" in latency_line(reports)


def test_line_is_empty_while_nothing_is_answered():
    assert latency_line({"/hull_server": report(latency_p50_ms="15.10"), "/ekf_tracker": report(rate_hz="0.0")}) == ""
    assert latency_line({}) == ""
