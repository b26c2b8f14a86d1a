"""With which id did a run of frames begin, so that frames lost before the first that arrived can be counted?"""

from __future__ import annotations

FIRST_ID = 1  # GigE Vision: block ids begin at 1, 0 is reserved


def first_of_run(arrived: int, last_of_former_run: int | None) -> int:
    """The id of the first frame that the camera sent, given the first that arrived.

    Cameras begin at 1 with each stream, and most of them also with each start of acquisition; others go on counting
    where they stopped. ``last_of_former_run``: None for a stream's first run.
    """
    if last_of_former_run is not None and arrived > last_of_former_run:
        return arrived  # it goes on; how many it took after we stopped to look does not matter
    return FIRST_ID
