"""``.mp``: the subject's measures as Vicon's software keeps them, lines ``$Name = value`` in millimetres."""

from __future__ import annotations

import re
from pathlib import Path

from capture_rig.errors import InputError

LINE = re.compile(r"^\s*\$\s*(\w+)\s*=\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*$", re.MULTILINE)


def read_mp(path: Path, names: tuple[str, ...]) -> dict[str, float]:
    """The named measures of a ``.mp`` file, mm; InputError naming the file and what it lacks."""
    try:
        text = path.read_text(encoding="latin-1")
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), remedy="It lies in Mocap_Data beside the .c3d files."
        ) from None
    measures = {name: float(value) for name, value in LINE.findall(text)}
    missing = [name for name in names if name not in measures]
    if missing:
        raise InputError(
            f"has no line '${missing[0]} = number'", where=str(path), remedy="Copy it again from the data set."
        )
    return {name: measures[name] for name in names}
