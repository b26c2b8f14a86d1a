"""Where compiled kernels are kept, and when they are out of date: as soon as a module changed that theirs imports.

numba itself looks at the file of the kernel alone, and would go on calling code that has changed in another file.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

PACKAGES = Path(__file__).resolve().parents[2]  # of this repository: PACKAGES/NAME/NAME/*.py
IMPORT = re.compile(r"^(?:from +([.\w]+) +)?import +(\([^)]*\)|[^\n]*)", re.MULTILINE)
COMMENT = re.compile(r"#[^\n]*")


@cache
def source_stamp(file: Path) -> str:
    """Return a hash of a module's source and of those of all modules of this repository that it imports."""
    found, waiting = {file}, [file]
    while waiting:
        new = set(imported(waiting.pop())) - found
        found |= new
        waiting += new
    return hashlib.sha256(b"".join(sorted(hashlib.sha256(_source(path)).digest() for path in found))).hexdigest()


@cache
def imported(file: Path) -> tuple[Path, ...]:
    """Return the files of this repository's modules that a module imports when it is loaded."""
    return tuple(path for name in _imported_names(file) for path in [_file_of(name)] if path is not None)


def _imported_names(file: Path) -> Iterator[str]:
    """Yield what may be a module's name: of ``from a import b`` both a and a.b."""
    for origin, names in IMPORT.findall(COMMENT.sub("", _source(file).decode())):
        dots = len(origin) - len(origin.lstrip("."))
        if dots and not file.is_relative_to(PACKAGES):
            continue
        folder = file.parents[dots - 1].relative_to(PACKAGES).parts[1:] if dots else ()
        module = ".".join((*folder, *filter(None, [origin[dots:]])))
        if module:
            yield module
        for name in names.strip("() \n").split(","):
            yield ".".join(filter(None, (module, name.split(" as ")[0].strip())))


def _file_of(module: str) -> Path | None:
    package, *rest = module.split(".")
    path = PACKAGES.joinpath(package, package, *rest)
    candidates = (path.with_suffix(".py") if rest else path / "__init__.py", path / "__init__.py")
    return next((file for file in candidates if file.is_file()), None)


@cache
def _source(file: Path) -> bytes:
    return file.read_bytes()


class _OfAllSources:
    """Is out of date when :func:`source_stamp` changes; one file a function, wherever in its module it stands."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return source_stamp(Path(self._py_file).resolve())

    def get_disambiguator(self) -> str:
        return "kernel"


class _GivenFolder(_OfAllSources, UserProvidedCacheLocator):
    """NUMBA_CACHE_DIR."""


class _BesideSource(_OfAllSources, InTreeCacheLocator):
    """``__pycache__``: found again when the checkout moves."""


class _UserFolder(_OfAllSources, UserWideCacheLocator):
    """``~/.cache/numba``."""


class _TemporaryFolder(_OfAllSources, UserWideCacheLocator):
    """A folder of this user's alone in the system's temporary one: of a user without a home who may not write here."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)
        self._cache_path = os.path.join(temporary_folder(), self.get_suitable_cache_subpath(file))

    def ensure_cache_path(self) -> None:
        """Raises OSError where somebody else could have put code into the folder."""
        folder = temporary_folder()
        Path(folder).mkdir(mode=0o700, exist_ok=True)
        found = os.lstat(folder)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
            raise PermissionError(f"{folder} is not this user's alone")
        super().ensure_cache_path()


def temporary_folder() -> str:
    """Return the folder for this user's kernels where neither the checkout nor a home can be written."""
    return os.path.join(tempfile.gettempdir(), f"sagoma_kernels_{os.getuid()}")


class _Files(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_GivenFolder, _BesideSource, _UserFolder, _TemporaryFolder]  # noqa: RUF012


class KernelCache(FunctionCache):
    """numba's cache of one function in the first of these folders that can be written."""

    _impl_class = _Files

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled code for a signature; None where it names a class that is gone or was renamed since."""
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):
            self.flush()
            return None
