"""python -m virtual_studio.gige: simulated GigE Vision cameras, without any of ROS."""

from __future__ import annotations

import argparse
import sys

from capture_rig.errors import InputError

from .command import add_arguments, run


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    parser = argparse.ArgumentParser(prog="python -m virtual_studio.gige")
    add_arguments(parser)
    try:
        return run(parser.parse_args(arguments))
    except InputError as error:
        print(f"studio: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
