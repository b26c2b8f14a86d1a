"""What every carving backend offers."""

from __future__ import annotations

from typing import Any, Protocol

from ..bricks import BrickVolume
from ..views import Masks


class CarveBackend(Protocol):
    """Carves the silhouettes of one frame set after another; all backends obey the rule of hull_server.views.

    name : gl, sweep or cpu. device : what it runs on, for people.
    """

    name: str
    device: str

    def carve(self, masks: Masks, min_seeing: int) -> BrickVolume:
        """The hull of one canvas mask a camera (nonzero = foreground); cameras that are absent have no say."""
        ...

    def submit(self, masks: Masks, min_seeing: int) -> Any:
        """Begin to carve; the ticket is exchanged for the hull by :meth:`collect`, on any thread, in any order."""
        ...

    def collect(self, ticket: Any) -> BrickVolume:
        """The hull that :meth:`submit` began; waits for it."""
        ...

    def close(self) -> None:
        """Release what the backend holds; it cannot be used afterwards."""
        ...


class Immediate:
    """For backends that carve on the caller's thread: the ticket is the hull itself."""

    def submit(self: CarveBackend, masks: Masks, min_seeing: int) -> BrickVolume:
        """Carve."""
        return self.carve(masks, min_seeing)

    def collect(self, ticket: BrickVolume) -> BrickVolume:
        """The hull, which is there already."""
        return ticket
