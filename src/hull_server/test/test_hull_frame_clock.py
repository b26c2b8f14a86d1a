"""The exposures' period and phase, from stamps that jitter, drift, lack frames."""

from __future__ import annotations

import numpy as np
import pytest

from hull_server.overload.thinning_control import STAMPS_KEPT, FrameClock
from mocap_packets.thinning import FrameDecimation

EPOCH_NS = 1_790_000_000_000_000_000
PERIOD_NS = 1e9 / 60


def clock_of(cameras: dict[str, np.ndarray]) -> FrameClock:
    """A clock that has heard the stamps (ns after EPOCH_NS) of each camera."""
    clock = FrameClock()
    for name, stamps in cameras.items():
        for each in stamps:
            clock.add(name, EPOCH_NS + round(each))
    return clock


def distance_to_grid(phase_ns: int, period_ns: float, stamp_ns: float) -> float:
    turns = (EPOCH_NS - phase_ns + stamp_ns) / period_ns
    return abs(turns - round(turns))


@pytest.mark.parametrize("lost", [0.0, 0.3, 0.6])
def test_grid_is_found_in_jitter_and_loss(lost: float) -> None:
    rng = np.random.default_rng(3)
    stamps = {
        name: (np.arange(120) * PERIOD_NS + rng.normal(0, 3e5, 120))[rng.uniform(size=120) >= lost] for name in "abcde"
    }
    grid = clock_of(stamps).estimate()
    assert grid is not None and grid.period_ns == pytest.approx(PERIOD_NS, rel=2e-3)
    assert distance_to_grid(grid.phase_ns, grid.period_ns, 119 * PERIOD_NS) < 0.05


def test_cameras_that_run_freely_have_the_grid_in_their_middle() -> None:
    k = np.arange(STAMPS_KEPT)
    grid = clock_of({"a": k * PERIOD_NS, "b": (k + 0.4) * PERIOD_NS}).estimate()
    assert grid is not None
    assert distance_to_grid(grid.phase_ns, grid.period_ns, (k[-1] + 0.2) * PERIOD_NS) < 0.01


def test_fastest_camera_gives_the_period() -> None:
    k = np.arange(STAMPS_KEPT)
    grid = clock_of({"a": k * PERIOD_NS, "b": 2 * k[: STAMPS_KEPT // 2] * PERIOD_NS}).estimate()
    assert grid is not None and grid.period_ns == pytest.approx(PERIOD_NS, rel=1e-6)


def test_thinned_stamps_refine_the_grid_of_their_rule() -> None:
    true_ns = PERIOD_NS * (1 + 2e-4)
    rule = FrameDecimation(0, 0, EPOCH_NS, PERIOD_NS, 9, 20)
    k = np.array([k for k in range(90) if k * 9 % 20 < 9])
    grid = clock_of({"a": k * true_ns, "b": k * true_ns}).estimate(rule)
    assert grid is not None and grid.period_ns == pytest.approx(true_ns, rel=1e-6)
    assert grid.phase_ns == pytest.approx(EPOCH_NS, abs=1e3)


RANDOM_NS = np.cumsum(np.random.default_rng(1).uniform(1e6, 5e7, 40))


@pytest.mark.parametrize("stamps", [np.arange(3) * PERIOD_NS, RANDOM_NS])
def test_too_few_stamps_or_stamps_on_no_grid_give_none(stamps: np.ndarray) -> None:
    assert clock_of({"a": stamps}).estimate() is None


def test_stamps_before_a_jump_are_forgotten() -> None:
    clock = clock_of({"a": np.arange(40) * PERIOD_NS})
    for k in range(20):
        clock.add("a", EPOCH_NS - 10**12 + round(2 * k * PERIOD_NS))
    grid = clock.estimate()
    assert grid is not None and grid.period_ns == pytest.approx(2 * PERIOD_NS, rel=1e-6)
