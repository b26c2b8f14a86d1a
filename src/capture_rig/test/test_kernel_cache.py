"""Kernels: what makes a cached one out of date, where caches go, and what callers see of the parts they call."""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import event

import capture_rig
from capture_rig.kernel import _KernelDispatcher, _PartDispatcher, njit

LEAF = """
from capture_rig.kernel import njit

@njit(cache=True)
def leaf(x):
    return x + {number}
"""
CALLER = """
from capture_rig.kernel import njit
from .leaf import (  # (the one that changes)
    leaf,
)

@njit(cache=True)
def caller(x):
    return 10 * leaf(x)
"""
OTHER = """
from capture_rig.kernel import njit

@njit(cache=True)
def other(x):
    return -x
"""
RUN = """
import sys
from play.caller import caller
from play.other import other
print(caller(1), other(1), *(sum(f.stats.cache_hits.values()) for f in (caller, other)))
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A repository of two packages, ``capture_rig`` and one with kernels that call another, all in the cache."""
    packages, source = tmp_path_factory.mktemp("compiled") / "checkout", Path(capture_rig.__file__).parent
    shutil.copytree(source, packages / "capture_rig" / "capture_rig", ignore=shutil.ignore_patterns("__pycache__"))
    play = packages / "play" / "play"
    play.mkdir(parents=True)
    (play / "__init__.py").write_text("")
    (play / "leaf.py").write_text(LEAF.format(number=1))
    (play / "caller.py").write_text(CALLER)
    (play / "other.py").write_text(OTHER)
    assert run(packages) == [20, -1, 0, 0]
    return packages


@pytest.fixture
def checkout(compiled, tmp_path):
    """The same, copied with its cache: what a checkout is that was moved."""
    return shutil.copytree(compiled, tmp_path / "elsewhere")


def run(packages, **environment):
    """Call both kernels in a process of its own; returns their results and cache hits."""
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    paths = os.pathsep.join(str(path) for path in packages.iterdir())
    done = subprocess.run(
        [sys.executable, "-B", "-c", RUN],
        env=kept | {"PYTHONPATH": paths} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return [int(word) for word in done.stdout.split()]


def test_moved_checkout_finds_its_cache_and_recompiles_what_calls_a_changed_kernel(checkout):
    assert {path.name.split("-")[0] for path in checkout.rglob("*.nbi")} == {"caller.caller", "other.other"}  # no leaf
    before = sorted(path.name for path in checkout.rglob("*.nb?"))
    (checkout / "play" / "play" / "leaf.py").write_text(LEAF.format(number=2))
    assert run(checkout) == [30, -1, 0, 1]
    (checkout / "play" / "play" / "caller.py").write_text("\n\n" + CALLER)
    assert run(checkout) == [30, -1, 0, 1]
    assert sorted(path.name for path in checkout.rglob("*.nb?")) == before  # nothing of the old ones is left


@pytest.mark.slow
def test_cache_that_names_a_class_which_is_gone_is_made_anew(checkout):
    (index,) = checkout.rglob("caller.caller*.nbi")
    index.write_bytes(pickle.dumps(numba.__version__) + b"cgone\nPlay\n.")
    assert run(checkout) == [20, -1, 0, 1]
    assert run(checkout) == [20, -1, 1, 1]


@njit(cache=False)
def refuses(x):
    if x < 0:
        raise ValueError("negative")
    return np.full(3, x)


@njit(cache=False)
def calls(x):
    return refuses(x).sum()


@njit(cache=False)
def of_numpy(values):
    return np.sort(np.concatenate((values, np.zeros(2)))).sum()


def test_what_a_called_function_raises_reaches_python():
    assert calls(2.0) == 6.0
    with pytest.raises(ValueError, match="negative"):
        calls(-1.0)


def test_what_numba_wrote_of_numpy_is_a_part_of_its_callers():
    with event.install_recorder("numba:compile") as compiled:
        assert of_numpy(np.array([3.0, 1.0, 2.0])) == 6.0
    kinds = [type(begun.data["dispatcher"]) for _, begun in compiled.buffer if begun.is_start]
    assert kinds[0] is _KernelDispatcher and len(kinds) > 3 and set(kinds[1:]) == {_PartDispatcher}


def test_kernel_can_be_sent_to_another_process():
    sent = subprocess.run(
        [sys.executable, "-c", "import pickle, sys; print(pickle.loads(sys.stdin.buffer.read())(2.0))"],
        input=pickle.dumps(calls),
        capture_output=True,
        check=True,
    )
    assert float(sent.stdout) == 6.0


@njit(cache=False, crops=True)
def total_of(image):
    total = 0
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            total += image[row, column]
    return total


def test_images_and_their_crops_share_one_machine_code():
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert total_of(image) == 66 and total_of(image[:, 1:3]) == 33 and total_of(image[:2]) == 28
    assert len(total_of.overloads) == 1
