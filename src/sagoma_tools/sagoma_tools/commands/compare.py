"""``sagoma compare A B``: do two bags hold the same messages, byte for byte?"""

from __future__ import annotations

import argparse

from capture_rig.errors import InputError

from ..recording.reader import bag_digest, default_comparison, first_difference


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("compare", help="compare two bags byte for byte, topic by topic")
    parser.add_argument("a", help="a bag")
    parser.add_argument("b", help="another bag")
    parser.add_argument("--topics", nargs="+", help="topics to compare (default: all that must be the same)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print one line a topic with its SHA-256; 0 when all agree."""
    topics = args.topics or sorted({*default_comparison(args.a), *default_comparison(args.b)})
    if not topics:
        raise InputError(
            "neither bag holds an output of the graph",
            where=f"{args.a}, {args.b}",
            remedy="Name the topics to compare with --topics.",
        )
    digests_a, digests_b = bag_digest(args.a, topics), bag_digest(args.b, topics)
    different = [topic for topic in topics if digests_a[topic] != digests_b[topic]]
    for topic in topics:
        verdict = "DIFFERENT" if topic in different else "identical"
        print(f"{verdict}  {digests_a[topic].count:6d} messages  sha256 {digests_a[topic].sha256[:16]}  {topic}")
    for topic in different:
        print(first_difference(args.a, args.b, topic))
    print("the bags differ" if different else f"identical on {len(topics)} topics")
    return 1 if different else 0
