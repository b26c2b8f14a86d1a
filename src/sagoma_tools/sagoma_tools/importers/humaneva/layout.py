"""Where the data set keeps the files of one trial of one subject."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from capture_rig.errors import InputError

CAMERAS = ("C1", "C2", "C3", "BW1", "BW2", "BW3", "BW4")
"""Colour before grey cameras: the order in which the data set's own code takes them."""


@dataclass(frozen=True)
class Trial:
    """One trial, e.g. subject ``S2``, action ``Walking``, number 1, below the folder that holds S1 to S4."""

    root: Path
    subject: str
    action: str
    number: int

    def __post_init__(self) -> None:
        if not (self.root / self.subject).is_dir():
            subjects = sorted(p.name for p in self.root.glob("S[0-9]") if p.is_dir())
            have = f"It has {', '.join(subjects)}." if subjects else "Give the folder that holds S1, S2, S3, S4."
            raise InputError(f"has no folder '{self.subject}'", where=str(self.root), remedy=have)

    def __str__(self) -> str:
        return f"{self.subject} {self.action}_{self.number}"

    def video(self, camera: str) -> Path:
        return self._existing(self.folder / "Image_Data" / f"{self.action}_{self.number}_({camera}).avi")

    def calibration(self, camera: str) -> Path:
        return self._existing(self.folder / "Calibration_Data" / f"{camera}.cal")

    def offsets(self) -> dict[str, Path]:
        """The ``.ofs`` file of every camera that has one for this trial."""
        paths = {c: self.folder / "Sync_Data" / f"{self.action}_{self.number}_({c}).ofs" for c in CAMERAS}
        found = {camera: path for camera, path in paths.items() if path.is_file()}
        if not found:
            self._existing(paths["C1"])
        return found

    def mocap(self) -> Path:
        return self.folder / "Mocap_Data" / f"{self.action}_{self.number}.c3d"

    def static_mocap(self) -> Path:
        return self.folder / "Mocap_Data" / "Static.c3d"

    def measures(self) -> Path:
        return self.folder / "Mocap_Data" / f"{self.subject}.mp"

    def backgrounds(self, camera: str) -> list[Path]:
        """The movies of the empty room for a camera, at least one."""
        folder = self.root / "Background"
        found = sorted(folder.glob(f"Background_*_({camera}).avi"))
        if not found:
            raise InputError(
                f"has no Background_*_({camera}).avi",
                where=str(folder),
                remedy="Unpack the data set's background movies there.",
            )
        return found

    @property
    def folder(self) -> Path:
        return self.root / self.subject

    def _existing(self, path: Path) -> Path:
        if path.is_file():
            return path
        pattern = re.sub(r"\([^)]*\)", "(*)", path.name).replace(f"{self.action}_{self.number}_", "*_")
        there = sorted({re.sub(r"_\(.*", "", p.stem) for p in path.parent.glob(pattern)})
        folder = path.parent.name
        remedy = f"{folder} has {', '.join(there)}." if there else f"Unpack {folder} of the data set."
        raise InputError("is not there", where=str(path), remedy=remedy)
