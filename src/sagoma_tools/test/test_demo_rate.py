"""The demo's rate: what the graph holds under load, whether the capture is sound, and what it says."""

from types import SimpleNamespace

import pytest

from sagoma_tools.cli import main
from sagoma_tools.commands import demo
from sagoma_tools.commands.demo import next_step, pace, unsound
from sagoma_tools.evaluation import live_run


def test_capture_is_sound_when_sets_are_answered_and_somebody_is_tracked_and_lines_say_what_to_do_next():
    assert unsound(90, 88, 80) == ""
    assert "only 80 of 100" in unsound(100, 80, 80) and "only 10 of 100" in unsound(100, 100, 10)
    for held_hz, speed, said in (
        (59.5, 1.0, "holds all the cameras' 60 Hz"),
        (36.2, 1.0, "36 Hz of the cameras' 60 Hz; all left out the same frames"),
        (60.0, 1 / 16, "shown at 1/16 of the speed of 5 cameras at 60 Hz"),
    ):
        assert pace(SimpleNamespace(hz_held=held_hz, speed=speed), 5, 60.0).endswith(said)
    assert "--rate 0" in next_step(1.0) and "--rate 0" not in next_step(0.0)  # that was done


@pytest.mark.parametrize(
    ("asked", "outcomes", "speeds"),
    [
        (None, [30.0], [1.0]),
        (None, [9.0, 60.0], [1.0, 1 / 8]),
        (None, [16.0, "torn", 60.0], [1.0, 1 / 4, 1 / 8]),
        (None, [1.0, "torn"], [1.0, 1 / 32]),
        (1 / 4, ["torn"], [1 / 4]),
    ],
)
def test_cameras_go_slower_until_the_machine_answers_whole_sets(tmp_path, monkeypatch, asked, outcomes, speeds):
    tried = []

    def studio(session, folder, fps, speed, *, cancel):
        tried.append(speed)

    def run(live_input, output, **options):
        outcome = outcomes[len(tried) - 1]
        return SimpleNamespace(is_whole=outcome != "torn", hz_held=60.0 if outcome == "torn" else outcome)

    monkeypatch.setattr(live_run, "StudioInput", studio)
    monkeypatch.setattr(live_run, "run_live", run)
    live_run.run_studio("session", tmp_path, 60.0, asked)
    assert tried == speeds


def test_a_demo_that_tracked_nobody_says_why_and_fails(tmp_path, monkeypatch, capsys):
    why = "cam02 does not see your feet: turn cam02 down"
    told, reasons = f'of 60 frame sets the tracker said "{why}" in 58, ', [(why,)] * 58 + [("no hull",)] * 2
    nobody = SimpleNamespace(
        bag=tmp_path / "bag", sets=60, answered=58, incomplete=3, sets_per_s=9.0, hz_held=60.0,
        speed=1.0, track=[], usage={}, diagnostics={}, ages_ms={},
        session=SimpleNamespace(fps=60.0), reasons=reasons,
    )  # fmt: skip
    monkeypatch.setattr(demo, "FootageInput", lambda session, rate: None)
    monkeypatch.setattr(demo, "run_live", lambda *arguments, **options: nobody)
    monkeypatch.setattr(demo, "finish_take", lambda bag: None)
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--session", "any", "--rate", "0"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert f"tracked in none of 58 frame sets; {told}" in said and "docs/how-to/tracking.md" in said
