"""Environment and data of all tests.

The environment is set when pytest loads this file, before a test module can import rclpy or numpy, which read it once.
Processes that tests start inherit it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

_LOGS = tempfile.TemporaryDirectory(prefix="sagoma_test_logs_")  # removed when pytest ends

# nothing leaves this machine
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_LOG_DIR"] = _LOGS.name
# two test runs side by side (or a live graph) do not hear each other; ports stay below those of outgoing connections
_DOMAINS, _DOMAINS_A_RUN = range(40, 100), 12
_CHOSEN_DOMAIN = os.environ.get("ROS_DOMAIN_ID")
_folders: list[Path] = []  # of the tests run so far, in the order of their domains

# on few cores the thread pools of BLAS cost more than they give
for _pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

SHARED_DATA = Path(os.environ.get("SAGOMA_SHARED_DATA", Path(__file__).resolve().parent.parent / "shared" / "data"))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A domain of its own for the tests of each folder, unless ROS_DOMAIN_ID was set: leftovers are not heard."""
    if item.path.parent not in _folders:
        _folders.append(item.path.parent)
    index = os.getpid() * _DOMAINS_A_RUN + _folders.index(item.path.parent)
    os.environ["ROS_DOMAIN_ID"] = _CHOSEN_DOMAIN or str(_DOMAINS[index % len(_DOMAINS)])


@pytest.fixture(scope="session")
def shared_data() -> Callable[..., Path]:
    """``shared_data("sessions", "walk_ring5top")``: a path in the test data; skips the test where it is absent.

    The data is no part of the product. It is looked for in ../shared/data, or where SAGOMA_SHARED_DATA points.
    """

    def find(*parts: str) -> Path:
        path = SHARED_DATA.joinpath(*parts)
        if not path.exists():
            pytest.skip(f"test data {path} is not on this machine (SAGOMA_SHARED_DATA names its folder)")
        return path

    return find
