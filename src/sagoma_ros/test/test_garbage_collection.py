"""What a node holds once it is active is spared by garbage collections; what was garbage then is freed."""

from __future__ import annotations

import gc
import weakref
from collections import deque
from collections.abc import Iterator

import pytest

from sagoma_ros.process import freeze_garbage_collector

RINGS = 20_000


class Ring:
    """Refers to itself: only the collector can free it."""

    def __init__(self) -> None:
        self.next = self


@pytest.fixture(autouse=True)
def collector_as_before() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.unfreeze()
    gc.set_threshold(*before)


def test_garbage_is_freed_and_what_is_in_use_is_left_alone() -> None:
    kept, garbage = Ring(), weakref.ref(Ring())
    freeze_garbage_collector()
    assert garbage() is None
    assert gc.get_freeze_count() > 0 and not any(each is kept for each in gc.get_objects())


def test_what_was_spared_is_freed_the_next_time_when_nobody_holds_it_any_more() -> None:
    held = [Ring()]
    once = weakref.ref(held[0])
    freeze_garbage_collector()
    held.clear()
    gc.collect()
    assert once() is not None
    freeze_garbage_collector()
    assert once() is None


def test_garbage_that_lived_for_a_while_does_not_pile_up_behind_what_is_frozen() -> None:
    """Python itself waits until a quarter of what it last went through is garbage: of what is frozen now."""
    in_use = [Ring() for _ in range(5 * RINGS)]
    freeze_garbage_collector()
    young = deque[Ring](maxlen=RINGS // 5)  # they outlive the collections of the young
    for _ in range(RINGS):
        young.append(Ring())
    left = sum(isinstance(each, Ring) for each in gc.get_objects())
    assert left < len(young) + RINGS // 2 and len(in_use) == 5 * RINGS
