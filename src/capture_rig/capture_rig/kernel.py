"""Compiles functions that only compute on arrays (numba), cached; functions that kernels call are compiled within them.

numba makes machine code of every function that a kernel calls, then inlines its code into the caller, optimises that
and makes machine code once more, which took most of the compile time. Here a function that is called from a kernel is
only typed and lowered (:class:`_PartDispatcher`), and so are numpy's functions that numba implements in Python; entry
points from Python are optimised, and cached, once and as a whole.

A cache entry is invalid as soon as any module that the kernel's module imports has changed. (numba itself checks the
file of the kernel alone, and would go on calling code that has changed in another file.)
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import sigutils, types
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.target_extension import jit_registry, target_registry
from numba.core.typed_passes import NativeLowering
from numba.extending import overload
from numba.np import arrayobj

PACKAGES = Path(__file__).resolve().parents[2]  # of this repository: PACKAGES/NAME/NAME/*.py
IMPORT = re.compile(r"^(?:from +([.\w]+) +)?import +(\([^)]*\)|[^\n]*)", re.MULTILINE)
COMMENT = re.compile(r"#[^\n]*")
OPTIONS: dict[str, Any] = {"nopython": True, "boundscheck": None, "no_cfunc_wrapper": True}
NO_ENTRY = {"no_cpython_wrapper": True}  # not called from Python
ARITHMETIC: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "forceinline": True, "_nrt": False}


def njit(*, cache: bool, crops: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles as ``numba.njit`` does with these options.

    crops : images come whole or as parts of larger ones, and are compiled once, as parts.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        compiled = (_CropDispatcher if crops else _KernelDispatcher)(function, targetoptions=OPTIONS | options)
        if cache:
            compiled.enable_caching()
        return compiled

    return decorate


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that only computes on its argument arrays: it may neither make arrays nor raise.

    Such functions need no reference counts, which would cost more here than all arithmetic (``_nrt``), and those that
    they call become part of them, so that passing a dozen arrays on costs nothing (``forceinline``). Slices are free
    too, and often better than an offset: their indices are known not to be negative, so that loops vectorise. Other
    Python threads run meanwhile (``nogil``).
    """
    return njit(**ARITHMETIC)(function)


class _PartLibrary(JITCodeLibrary):
    """The lowered code of a function and of its callees: for its callers, not to be run on its own."""

    def _optimize_final_module(self) -> None:
        """Do nothing: callers optimise it as a part of themselves."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        state.targetctx.insert_user_function(state.library, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=state.library)
        return True


class _PartCompiler(CompilerBase):
    def define_pipelines(self) -> list[PassManager]:
        steps = DefaultPassBuilder.define_nopython_pipeline(self.state).passes
        pipeline = PassManager("part")
        pipeline.passes = [(_PartLowering if step is NativeLowering else step, what) for step, what in steps]
        pipeline.finalize()
        return [pipeline]


class _PartDispatcher(CPUDispatcher):
    """A function as kernels call it."""

    def add_overload(self, compiled: Any) -> None:
        self.overloads[tuple(compiled.signature.args)] = compiled


class _KernelPartDispatcher(_PartDispatcher):
    """A kernel as kernels call it. Constants are numbers like any other to it, not types of their own."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template([_plain(a) for a in args], {name: _plain(a) for name, a in kws.items()})

    def get_overload(self, signature: Any) -> Any:
        return super().get_overload(tuple(_plain(a) for a in signature))


class _KernelDispatcher(CPUDispatcher):
    """A function as Python calls it; kernels call its part instead."""

    def __init__(self, function: Callable[..., Any], locals: Any = None, targetoptions: Any = None) -> None:
        """As numba does when it unpickles one, too."""
        super().__init__(function, locals, targetoptions)
        self._part = _KernelPartDispatcher(function, locals, targetoptions | NO_ENTRY, _PartCompiler)

    def enable_caching(self) -> None:
        with suppress(RuntimeError):  # no folder can be written: every process compiles its kernels
            self._cache = KernelCache(self.py_func)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._part.get_call_template(args, kws)

    def get_overload(self, signature: Any) -> Any:
        return self._part.get_overload(signature)


class _CropDispatcher(_KernelDispatcher):
    """A kernel of images, contiguous or not: one machine code for both, since any crop may be as wide as its image."""

    def compile(self, sig: Any) -> Any:
        given, _ = sigutils.normalize_signature(sig)
        taken = tuple(map(_as_crop, given))
        code = super().compile(taken)
        if taken != tuple(given):
            self._insert([kind._code for kind in given], code, False)  # type: ignore[attr-defined]  # of the C base class
        return code


def _part_of_numpy(**options: Any) -> Callable[[Callable[..., Any]], _PartDispatcher]:
    return lambda function: _PartDispatcher(function, None, OPTIONS | options, _PartCompiler)


jit_registry.update({target_registry["cpu"]: _part_of_numpy})  # what numba wrote in Python of numpy: parts as well


def _raise_of_shapes(source: Any, target: Any) -> None:
    """Raise of an assignment between arrays of two shapes. (numba's own writes both out: a sixth of all time.)"""


@overload(_raise_of_shapes)
def _compile_raise_of_shapes(source: Any, target: Any) -> Callable[[Any, Any], None]:
    def raise_of_shapes(source: Any, target: Any) -> None:
        raise ValueError("cannot assign an array of another shape")

    return raise_of_shapes


arrayobj.raise_with_shape_context = _raise_of_shapes

# numba compares the flags of a function thousands of times, which took a tenth of all time
_DEFAULT_FLAGS = {name: option.default for name, option in Flags.options.items()}
Flags.values = lambda flags: _DEFAULT_FLAGS | flags._values  # type: ignore[method-assign]


def _as_crop(kind: types.Type) -> types.Type:
    return kind.copy(layout="A") if isinstance(kind, types.Array) and kind.ndim > 1 else kind


def _plain(kind: types.Type) -> types.Type:
    return types.unliteral(kind) if isinstance(kind, types.IntegerLiteral | types.BooleanLiteral) else kind


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


class _Files(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_GivenFolder, _BesideSource, _UserFolder]  # noqa: RUF012


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
