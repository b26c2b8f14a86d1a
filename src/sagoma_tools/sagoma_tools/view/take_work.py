"""What the page's buttons do with takes: rename, trim, delete, export, video; through the same code as the commands."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

from capture_rig.errors import InputError

from ..takes.exporting import EXPORTS, FORMATS, Options, export_take
from ..takes.folder import TakesFolder
from ..takes.texts import MIB
from ..takes.trim import trim
from ..takes.video import VIDEO, write_video
from .jobs import Tell, Work

ALL_FORMATS = "all formats"
SHOWN_EVERY = 15  # frames of a video
Deliver = Callable[[str, bytes], None]
"""Gives a file of this name to who asked for it."""


class TakeWork:
    """Makes the work of the takes' buttons; every take is named by its name in one folder."""

    def __init__(self, takes: TakesFolder, recording: Callable[[], str]) -> None:
        """``recording`` : says the name of the take that is being recorded, which is left alone."""
        self._takes, self._recording = takes, recording

    def rename(self, name: str, new_name: str) -> Work:
        """Give a take another name."""

        def work(tell: Tell) -> str:
            self._check(name)
            return f"{name} is now {self._takes.rename(name, new_name).name}"

        return work

    def trim(self, name: str, new_name: str, from_s: float, to_s: float) -> Work:
        """Make a new take of a part."""

        def work(tell: Tell) -> str:
            self._check(name)
            if not new_name.strip():
                raise InputError("a part needs a name of its own", where="new name", remedy="Write one.")
            path = trim(self._takes, name, new_name, from_s, to_s)
            return f"made {path.name}: {from_s:.2f} s to {to_s:.2f} s of {name}"

        return work

    def delete(self, name: str) -> Work:
        """Move a take into the bin."""

        def work(tell: Tell) -> str:
            self._check(name)
            return f"{self._takes.delete(name).name} is in the bin: 'restore' brings it back"

        return work

    def restore(self, tell: Tell) -> str:
        """Bring back what was deleted last."""
        deleted = self._takes.deleted()
        return f"{self._takes.restore(deleted[0].path.name).name} is back" if deleted else "the bin is empty"

    def export(self, name: str, kind: str, deliver: Deliver) -> Work:
        """Write files of other programs into the take's folder, and give them to who asked, several as one zip."""

        def work(tell: Tell) -> str:
            self._check(name)
            take = self._takes.find(name)
            formats = list(FORMATS) if kind == ALL_FORMATS else [kind]
            files = export_take(take.path, take.path / EXPORTS, formats, Options(overwrite=True), tell)
            _deliver([file.path for file in files], f"{name}_{kind.replace(' ', '_')}.zip", deliver)
            return f"exported {', '.join(file.path.name for file in files)} into {take.name}/{EXPORTS}"

        return work

    def video(self, name: str, deliver: Deliver) -> Work:
        """Draw the take's video, unless it has been drawn, and give it to who asked."""

        def work(tell: Tell) -> str:
            self._check(name)
            take = self._takes.find(name)
            path = take.path / EXPORTS / VIDEO

            def progress(frame: int, frames: int) -> None:
                if frame % SHOWN_EVERY == 0:
                    tell(f"drawing the video of {name}: {100 * frame / frames:.0f} %")

            if not path.exists():
                write_video(take, path, progress=progress)
            deliver(f"{name}.mp4", path.read_bytes())
            return f"{name}/{EXPORTS}/{VIDEO}, {path.stat().st_size / MIB:.1f} MB"

        return work

    def _check(self, name: str) -> None:
        if name and name == self._recording():
            raise InputError(f"'{name}' is being recorded", where="takes", remedy="Finish the recording first.")


def _deliver(paths: list[Path], name: str, deliver: Deliver) -> None:
    if len(paths) == 1:
        deliver(paths[0].name, paths[0].read_bytes())
        return
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in paths:
            archive.write(path, path.name)
    deliver(name, packed.getvalue())
