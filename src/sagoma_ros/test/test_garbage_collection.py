"""What a node holds once it is active is spared by garbage collections; what was garbage then is freed."""

from __future__ import annotations

import gc
import weakref

from sagoma_ros.process import freeze_garbage_collector


class Ring:
    """Refers to itself: only the collector can free it."""

    def __init__(self) -> None:
        self.next = self


def test_garbage_is_freed_and_what_is_in_use_is_left_alone() -> None:
    kept, garbage = Ring(), weakref.ref(Ring())
    try:
        freeze_garbage_collector()
        assert garbage() is None
        assert gc.get_freeze_count() > 0 and not any(each is kept for each in gc.get_objects())
    finally:
        gc.unfreeze()


def test_what_was_spared_is_freed_the_next_time_when_nobody_holds_it_any_more() -> None:
    held = [Ring()]
    once = weakref.ref(held[0])
    try:
        freeze_garbage_collector()
        held.clear()
        gc.collect()
        assert once() is not None
        freeze_garbage_collector()
        assert once() is None
    finally:
        gc.unfreeze()
