"""``sagoma evaluate``: how good the tracking of a session is, in one process and without ROS timing."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session

from ..evaluation.in_process import Configuration, track_session
from ..evaluation.scores import Scores, score
from ..evaluation.tables import print_scores
from ..evaluation.track import Track, track_from_bag
from ..live_run import REFERENCE_START, T_POSE_START, start_settings
from ..playing import play_of_bag
from .common import add_settings_argument, parse_settings

THESIS = {"icp_tracker.method": "hierarchical", "ekf_tracker.filter.motion_model": "identity"}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("evaluate", help="track a session (or read a bag of one) and compare with its truth")
    parser.add_argument("session", help="folder of footage with a truth")
    parser.add_argument("--bag", help="score this bag, recorded on the session, instead of tracking it here")
    parser.add_argument("--exact-masks", action="store_true", help="take the session's exact silhouettes")
    parser.add_argument(
        "--thesis", action="store_true", help="also run the thesis's method: hierarchical ICP, identity EKF"
    )
    parser.add_argument("--start", choices=("auto", T_POSE_START, REFERENCE_START), default="auto",
                        help="first pose: from a T-pose, or from the session's reference")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the line of JSON only")
    add_settings_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Track or read, score, print a table and, last, one line of JSON."""
    session = load_session(args.session)
    if session.truth is None:
        raise InputError(
            "has no truth.csv or reference*.csv", where=args.session, remedy="Give a session with a truth."
        )
    settings = {**start_settings(session, args.start), **parse_settings(args.settings)}
    track = recorded(args.bag, session) if args.bag else tracked(session, settings, args.exact_masks)
    scores = score(track, session.truth)
    figures = {**scores.figures(), "time_to_track_s": round(float(track.frames[0]) / session.fps, 3)}
    if args.thesis:
        thesis = score(tracked(session, {**settings, **THESIS}, args.exact_masks), session.truth)
        figures["thesis_mean_mm"] = round(thesis.mean_mm, 4)
    if not args.json:
        report(Console(), args.session, scores, figures)
    print(json.dumps(figures))
    return 0


def recorded(bag: str, session: Session) -> Track:
    """The track in a bag that was recorded while the session played."""
    play = play_of_bag(bag, session)
    return track_from_bag(bag, play.frame_of).between(0, play.frames)


def tracked(session: Session, settings: Mapping[str, Any], exact_masks: bool) -> Track:
    """The session's track with these settings."""
    return track_session(session, Configuration.of(settings), exact_masks=exact_masks)


def report(console: Console, session: str, scores: Scores, figures: Mapping[str, Any]) -> None:
    """The table for people."""
    console.print(f"session {session}, tracking from {figures['time_to_track_s']:.2f} s on", style="bold")
    print_scores(console, scores)
    if "thesis_mean_mm" in figures:
        console.print(f"the thesis's method on the same silhouettes: mean {figures['thesis_mean_mm']:.1f} mm")
