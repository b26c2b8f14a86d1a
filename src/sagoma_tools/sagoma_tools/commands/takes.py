"""``sagoma takes | smooth | export | urdf``: recorded takes, their motion for other programs, and the body."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.text import Text

from capture_rig.errors import InputError
from capture_rig.settings import FRAME_RATE, SECONDS, number
from ekf_tracker.rep155 import body_id_of, human_urdf
from ekf_tracker.urdf import body_urdf
from mocap_packets.fit import FIRST_PERSON
from mocap_pipeline.configuration import Configuration
from stick_figure.body import STATURES_M, TYPICAL_STATURE_M, Body, load_body

from ..arguments import add_settings_argument, add_takes_argument, bag_of, chosen_take, parse_settings
from ..console import CommandConsole, doing, plain_table
from ..graph.topics import FIRST_BODY_ID
from ..recording.smoothing import smooth_bag
from ..takes.exporting import EXPORTS, FORMATS, VIDEO, export_take, write_video
from ..takes.folder import TAKES, TakesFolder, trim
from ..takes.measure import ERROR, OK, WARNING, digests, finish_take, verify
from ..takes.take import FIGURES, MIB, NOT_MEASURED, Summary, TakeState, date, figures, origin, remark, summary_lines

STATE_STYLE = {TakeState.WHOLE: "", TakeState.UNFINISHED: "yellow", TakeState.DAMAGED: "red"}
OnATake = Callable[[argparse.Namespace, TakesFolder, str], int]
CHECK_STYLE = {OK: "green", WARNING: "yellow", ERROR: "red"}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommands."""
    _add_takes(subparsers)
    _add_smooth(subparsers)
    _add_export(subparsers)
    _add_urdf(subparsers)


def _add_takes(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("takes", help="list, show, rename, trim, delete and check recorded takes")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)

    def of_all(name: str, run: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        added = verbs.add_parser(name, help=text)
        add_takes_argument(added)
        added.set_defaults(run=run)
        return added

    def verb(name: str, run: OnATake, text: str) -> argparse.ArgumentParser:
        added = of_all(name, lambda args: run(args, *chosen_take(args.take, args.takes)), text)
        added.add_argument("take", help="a take's name, or the folder of a bag")
        return added

    for parser in (
        of_all("list", list_takes, "all takes, the newest first"),
        verb("show", show, "everything that is known of a take"),
        verb("verify", check, "check that all of it is readable, and as it was recorded"),
    ):
        parser.add_argument("--json", action="store_true", help="for programs")
    verb("rename", rename, "give a take another name").add_argument("name", help="the new name")
    cut = verb("trim", trim_take, "make a new take of a part; the take stays as it is")
    cut.add_argument("name", help="the new take's name")
    cut.add_argument("--from", dest="from_s", type=SECONDS, default=0.0, metavar="S", help="second at which it begins")
    cut.add_argument("--to", dest="to_s", type=SECONDS, metavar="S", help="second at which it ends (default: the end)")
    film = verb("video", video, "write a video of it: each camera's silhouettes, with everybody drawn")
    help_output = f"mp4, webm (for browsers) or avi (default: TAKE/{EXPORTS}/{VIDEO})"
    film.add_argument("--output", metavar="FILE", help=help_output)
    verb("delete", delete, "move a take into the bin")
    back = of_all("restore", restore, "bring a deleted take back")
    back.add_argument("take", help="its name")
    of_all("bin", show_bin, "what is in the bin")
    gone = of_all("empty", empty, "remove what is in the bin for good")
    gone.add_argument("--yes", action="store_true", help="really")
    verb("measure", measure_anew, "measure a take's figures anew (or those of an old bag), and keep them")


def list_takes(args: argparse.Namespace) -> int:
    """Print a line a take."""
    folder = TakesFolder(Path(args.takes))
    takes = folder.takes()
    if args.json:
        print(json.dumps([take.document() for take in takes], indent=1))
        return 0
    if not takes:
        print(f"no takes in {args.takes}: record one with `sagoma record {args.takes}/NAME`, or on the page")
        return 0
    console, table = CommandConsole(), plain_table("", ("take", "recorded"), FIGURES)
    table.add_column("", no_wrap=True)
    for take in takes:
        table.add_row(take.name, date(take), *figures(take), remark(take), style=STATE_STYLE[take.state])
    console.print(table)
    for take in takes:
        if take.problem:
            console.print(f"{take.state}: {take.problem}", style=STATE_STYLE[take.state])
    if any(remark(take) == NOT_MEASURED for take in takes):
        console.print("not measured: `sagoma takes measure TAKE` measures it")
    if deleted := len(folder.deleted()):
        console.print(f"{deleted} in the bin: `sagoma takes bin`")
    return 0


def show(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Print everything that is known of a take; 1 when it cannot be read."""
    take = folder.find(name)
    if args.json:
        print(json.dumps(take.document(), indent=1))
        return 0 if take.state is TakeState.WHOLE else 1
    console = CommandConsole()
    console.print(f"{take.name}   {date(take)}   {take.seconds:.1f} s   {take.bytes / MIB:.1f} MB", style="bold")
    console.print(f"  {take.path.resolve()}")
    if take.state is not TakeState.WHOLE:
        console.print(f"  {take.state}: {take.problem}", style=STATE_STYLE[take.state])
        return 1
    console.print(f"  recorded by sagoma {take.software or '(unknown version)'}")
    if take.trimmed_from is not None:
        console.print(f"  {origin(take)}")
    if take.summary is None:
        console.print(f"  no figures: its recorder was killed (`sagoma takes measure {take.name}` measures them)")
    else:
        print_figures(console, take.summary)
    console.print(f"  {sum(take.topics.values())} messages on {len(take.topics)} topics")
    return 0


def print_figures(console: Console, summary: Summary) -> None:
    """Print a take's figures, moved in."""
    console.print("\n".join(f"  {line}" for line in summary_lines(summary)))


def check(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Print the results of every check; 1 when one found an error."""
    checks = verify(folder.find(name), doing("reading messages"))
    if args.json:
        print(json.dumps([vars(each) for each in checks], indent=1))
    else:
        console = CommandConsole()
        for each in checks:
            console.print(Text.assemble((f"{each.grade:8s}", CHECK_STYLE[each.grade]), each.text))
    return 1 if any(each.grade == ERROR for each in checks) else 0


def rename(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Rename a take."""
    print(f"{name} is now {folder.rename(name, args.name).name}")
    return 0


def trim_take(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Make a new take of a part."""
    path = trim(folder, name, args.name, args.from_s, args.to_s, doing("copying messages"))
    made = folder.find(path.name)
    print(f"made {path}: {made.summary.quality.seconds if made.summary else made.seconds:.1f} s, {origin(made)}")
    return 0


def video(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Write a video of a take."""
    take = folder.find(name)
    path = Path(args.output) if args.output else take.path / EXPORTS / VIDEO
    frames = write_video(take, path, doing("drawing frames"))
    print(f"{path}: {frames} frames, {path.stat().st_size / MIB:.1f} MB")
    return 0


def delete(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Move a take into the bin."""
    deleted = folder.delete(name)
    takes = "" if folder.path == Path(TAKES) else f" --takes '{folder.path}'"
    print(f"{deleted.name} is in the bin (`sagoma takes restore '{deleted.name}'{takes}` brings it back)")
    return 0


def restore(args: argparse.Namespace) -> int:
    """Bring a deleted take back."""
    print(f"{TakesFolder(Path(args.takes)).restore(args.take)} is back")
    return 0


def show_bin(args: argparse.Namespace) -> int:
    """List the bin."""
    deleted = TakesFolder(Path(args.takes)).deleted()
    for take in deleted:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.strptime(take.when, "%Y%m%d-%H%M%S"))
        print(f"{take.name}   deleted {when}")
    if not deleted:
        print("the bin is empty")
    return 0


def empty(args: argparse.Namespace) -> int:
    """Empty the bin for good, once the user confirms."""
    folder = TakesFolder(Path(args.takes))
    count = len(folder.deleted())
    if count and not args.yes:
        raise InputError(f"{count} takes would be removed for good", where="the bin", remedy="Say so: --yes.")
    print(f"removed {len(folder.empty_bin())} takes for good")
    return 0


def measure_anew(args: argparse.Namespace, folder: TakesFolder, name: str) -> int:
    """Measure a take again; refused if its files are not those that were recorded."""
    take = folder.find(name)
    if take.summary is not None and take.summary.files != digests(take.path):
        remedy = f"See `sagoma takes verify {name}`; bring the take back from a copy."
        raise InputError("its files are not those that were recorded", where=str(take.path), remedy=remedy)
    summary = finish_take(take.path, doing("reading messages")) if take.state is TakeState.WHOLE else None
    if summary is None:
        raise InputError("cannot be measured", where=str(take.path), remedy=f"See `sagoma takes verify {name}`.")
    print_figures(CommandConsole(), summary)
    return 0


# motion for other programs --------------------------------------------------------------------------------------------


ALL = "all"
MASS = number("kg", 2, 500)


def _add_export(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("export", help="write a take as BVH, glTF, C3D, TRC, OpenSim or CSV")
    option = parser.add_argument
    option("take", help="bag that `sagoma record`, `demo` or `smooth` wrote, or a take's name")
    help_format = "one or several of bvh, glb, c3d, trc, opensim (.osim and .mot), csv; or all"
    option("--format", nargs="+", default=[ALL], choices=(*FORMATS, ALL), metavar="FORMAT", help=help_format)
    option("--output", metavar="FOLDER", help="where the files go (default: TAKE/export)")
    option("--rate", type=FRAME_RATE, metavar="HZ", help="frames a second of the files (default: the take's own)")
    option("--mass", type=MASS, metavar="KG", help="of the person, for the OpenSim model (default: a BMI of 22)")
    option("--overwrite", action="store_true", help="replace files of earlier exports")
    add_takes_argument(parser)
    parser.set_defaults(run=run_export)


def run_export(args: argparse.Namespace) -> int:
    """Write every person of the take in every requested format, and print the files and the losses of a format."""
    formats = list(FORMATS) if ALL in args.format else args.format
    take = bag_of(args.take, args.takes)
    folder = Path(args.output) if args.output else take / EXPORTS
    export_take(take, folder, formats, args.rate, args.mass, args.overwrite, print)
    return 0


def _add_smooth(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("smooth", help="smooth a recorded take offline, in both directions of time")
    parser.add_argument("bag", help="bag that `sagoma record` or `demo` wrote")
    parser.add_argument("target", nargs="?", help="bag to make (default: BAG_smoothed)")
    add_settings_argument(parser)
    parser.set_defaults(run=run_smooth)


def run_smooth(args: argparse.Namespace) -> int:
    """Smooth the take and print how much of it has a state."""
    target = args.target or args.bag.rstrip("/") + "_smoothed"
    doing(f"smoothing {args.bag}")
    states, sets = smooth_bag(args.bag, target, Configuration.of(parse_settings(args.settings)).ekf)
    finish_take(Path(target))
    others = [f"{count} of person {person}" for person, count in sorted(states.items()) if person != FIRST_PERSON]
    print(f"smoothed {', '.join([f'{states[FIRST_PERSON]} of {sets} frame sets', *others])} into {target}")
    print(f"compare: sagoma evaluate {args.bag}; sagoma evaluate {target}")
    return 0


def _add_urdf(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("urdf", help="print the body as a URDF with the joints of /mocap/joint_states")
    whose = parser.add_mutually_exclusive_group()
    whose.add_argument("--body", help="body YAML, as ~/save_body of icp_tracker writes it")
    help_stature = f"an average body of this height in metres (default {TYPICAL_STATURE_M})"
    whose.add_argument("--stature", type=number("m", *STATURES_M), default=TYPICAL_STATURE_M, help=help_stature)
    help_id = f"what names of links begin with (default {FIRST_BODY_ID}, the first person's)"
    parser.add_argument("--id", default=FIRST_BODY_ID, help=help_id)
    parser.add_argument("--mass", type=MASS, metavar="KG", help="of the person (default: a BMI of 22)")
    parser.add_argument("--rep155", action="store_true", help="the URDF of REP-155, for /humans/bodies/ID/joint_states")
    parser.set_defaults(run=run_urdf)


def run_urdf(args: argparse.Namespace) -> int:
    """Print the URDF."""
    body = load_body(args.body) if args.body else Body.from_stature(args.stature)
    body_id = body_id_of(args.id, FIRST_PERSON)
    sys.stdout.write((human_urdf if args.rep155 else body_urdf)(body, body_id, args.mass))
    return 0
