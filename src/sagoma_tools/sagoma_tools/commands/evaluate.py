"""``sagoma evaluate``: scores the tracking of a session (in one process, without ROS timing) or of a bag."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session
from capture_rig.video import VideoFacts, ended_findings
from capture_rig.visibility import RigVisibility
from mocap_pipeline.session_footage import load_detections
from sagoma_bringup.launch_arguments import start_settings

from ..arguments import add_settings_argument, add_start_argument, parse_settings
from ..console import CommandConsole, doing
from ..evaluation.in_process import OURS, ROWS, THESIS, ablation_rows, track_people
from ..evaluation.scores import Scores, score
from ..evaluation.tables import print_ablation, print_evaluation, print_people
from ..evaluation.track import Track, clock_of_bag, is_bag, session_of_bag, tracks_from_bag
from ..evaluation.track_evaluation import PeopleScores, evaluate_track, identify, main_track, score_people

IN_JSON = ("mean_mm", "over_200mm", "inside_95")
"""Of each row of an ablation."""


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("evaluate", help="track a session (or read a bag of one) and compare with its truth")
    option = parser.add_argument
    option("session", metavar="SESSION|BAG", help="folder of footage, or a bag that was recorded on one")
    option("--bag", help="evaluate this bag, recorded on the session, instead of tracking it here")
    option("--exact-masks", action="store_true", help="take the session's exact silhouettes")
    help_keypoints = "joints that your detector found in the footage: FOLDER/CAM.csv, see the page on evaluation"
    option("--keypoints", metavar="FOLDER", help=help_keypoints)
    help_ablation = "also one row a part of the tracker, from the thesis's method to ours"
    option("--ablation", action="store_true", help=help_ablation)
    add_start_argument(parser)
    option("--plots", metavar="FOLDER", help="where pictures go (default: output/evaluate/SESSION)")
    option("--video", action="store_true", help="also write overlay.mp4, the track over all the footage")
    option("--json", action="store_true", help="print the line of JSON only; pictures only with --plots")
    add_settings_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Track or read a bag, evaluate, print tables, draw, and print one line of JSON last."""
    session, bag = find(args)
    everybody, frames = recorded(args, session, bag) if bag is not None else tracked(args, session)
    tracks = {name: main_track(of_all, session.truths, session.fps) for name, of_all in everybody.items()}
    switches = identify(everybody[OURS], session.truths, session.fps).switches[0] if session.truths else None
    evaluated = evaluate_track(session, frames, tracks[OURS], tracks.get(THESIS), switches)
    figures, console = evaluated.figures(), CommandConsole(stderr=args.json)
    rows: dict[str, Scores | None] = {}
    if args.ablation and session.truth is not None:
        rows = {name: score(tracks[name], session.truth) if len(tracks[name]) else None for name in ROWS}
    people = people_scores(session, everybody[OURS])
    if people is not None:
        figures |= people.figures(people_scores(session, everybody[THESIS]) if THESIS in everybody else None)
    if not args.json:
        print_evaluation(console, evaluated)
        if people is not None:
            print_people(console, people)
        if rows:
            print_ablation(console, rows)
    if args.plots or args.video or not args.json:
        from ..evaluation.pictures import draw, write_overlay

        folder = Path(args.plots) if args.plots else Path("output/evaluate") / session.folder.name
        paths, progress = draw(folder, evaluated), doing("drawing frames", evaluated.frames)
        if args.video and session.videos:
            paths.append(write_overlay(folder / "overlay.mp4", evaluated, progress))
        for path in paths:
            console.print(f"picture: {path}")
    if rows:
        figures["ablation"] = {
            name: scores and {key: round(float(scores.overall[key]), 4) for key in IN_JSON}
            for name, scores in rows.items()
        }
    print(json.dumps(figures))
    return 0


def find(args: argparse.Namespace) -> tuple[Session, str | None]:
    """Return the session, and the bag to evaluate, if one is given."""
    given = Path(args.session)
    if args.bag is None and is_bag(given):
        return session_of_bag(given), str(given)
    return load_session(given), args.bag


def recorded(args: argparse.Namespace, session: Session, bag: str) -> tuple[dict[str, dict[int, Track]], int]:
    """Return everybody's tracks in a bag that was recorded on the session, and frames."""
    if args.ablation:
        remedy = f"Run sagoma evaluate {session.folder} --ablation."
        raise InputError("a bag holds one track and no variants of it", where="--ablation", remedy=remedy)
    clock = clock_of_bag(bag, session)
    of_bag = tracks_from_bag(bag, clock.frame_of)
    return {OURS: {person: track.between(0, clock.frames) for person, track in of_bag.items()}}, clock.frames


def tracked(args: argparse.Namespace, session: Session) -> tuple[dict[str, dict[int, Track]], int]:
    """The session tracked with the given settings, by the thesis's method, and by every row of an ablation; frames."""
    if args.ablation and session.truth is None:
        remedy = "Leave out --ablation, or give a session with a truth."
        raise InputError("has no truth.csv or reference*.csv to compare with", where=args.session, remedy=remedy)
    rows = ablation_rows({**start_settings(session, args.start), **parse_settings(args.settings)})
    names = ROWS if args.ablation else (THESIS, OURS) if session.truth is not None else (OURS,)
    detections = load_detections(args.keypoints, session.rig) if args.keypoints else {}
    came: dict[str, VideoFacts] = {}
    try:
        tracks = track_people(
            session,
            {name: rows[name] for name in reversed(names)},  # ours first
            exact_masks=args.exact_masks,
            progress=doing("tracking frames"),
            ended=came.update,
            detections=detections,
            warned=lambda text: print(f"sagoma: {text}", file=sys.stderr),
        )
    finally:
        for finding in ended_findings(came) if came else ():
            print(f"sagoma: {finding}", file=sys.stderr)
    return tracks, min(facts.frames for facts in came.values())


def people_scores(session: Session, tracks: Mapping[int, Track]) -> PeopleScores | None:
    """Return everybody's scores; None for a session of one person."""
    if len(session.truths) < 2:
        return None
    return score_people(tracks, session.truths, session.fps, RigVisibility(session.rig))
