"""A whole set-up in one folder, as somebody has it before anything is calibrated: boards, empty room, a person.

What `footage` films, and session/ with camNN.mp4, camNN_background.mp4 and session.yaml: to be tracked, it lacks
nothing but rig.yaml. For scoring only: truth.csv beside the other truths.
"""

from __future__ import annotations

from pathlib import Path

from capture_rig.rig import Rig
from stick_figure.body import Body

from ..session import write_session
from ..whole_folder import whole_folder
from .footage import DESCRIPTION, FootagePlan, Progress, film_boards

SESSION, TRUTH = "session", "truth.csv"


def write_setup(
    folder: str | Path,
    rig: Rig,
    plan: FootagePlan | None = None,
    *,
    motion: str = "tour",
    seconds: float = 6.0,
    fps: float = 60.0,
    progress: Progress = lambda what: None,
) -> Path:
    """Films the boards, the empty room and a person who does ``motion`` for so long at so many frames a second.

    Returns ``folder``. Raises InputError as `write_session` and `write_calibration_footage` do.
    """
    folder, plan = Path(folder), plan or FootagePlan()
    with whole_folder(folder, DESCRIPTION) as partial:
        film_boards(partial, rig, plan, progress)
        session, body = partial / SESSION, Body.from_stature(plan.stature_m)
        write_session(session, rig, body, motion, fps, seconds, plan.seed, plan.noise, flicker=plan.flicker)
        _hide_truth(session, partial / TRUTH)
        progress(SESSION)
    return folder


def _hide_truth(session: Path, truth: Path) -> None:
    """What nobody knows who starts: where the person was, the outline, the calibration, the sizes."""
    (session / "truth.csv").rename(truth)
    for path in [session / "rig.yaml", session / "body.yaml", *session.glob("*_mask.*")]:
        path.unlink()
