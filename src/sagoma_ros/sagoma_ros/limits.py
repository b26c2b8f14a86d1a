"""Messages as they come: what they may hold at most, and how they are read from their bytes.

What is larger is refused and counted before memory is taken for it: a subscription with ``raw=True`` hands over a
message's bytes. The middleware keeps up to a queue (`qos.DEPTH`) of what was sent, whatever its size; these limits
bound what the nodes keep and work on.
"""

from __future__ import annotations

from typing import Any, TypeVar

from rclpy.serialization import deserialize_message

from capture_rig.errors import InputError

T = TypeVar("T")

MOST_CLOUD_BYTES = 8 << 20  # a hull of 5 mm voxels on five cameras sends less than 1 MB
MOST_TEXT_BYTES = 1 << 20  # the bodies of 250 persons have a quarter of it
MOST_JOINTS = 10_000  # 250 persons have 24 numbers each
MOST_MASK_BYTES = 4 << 20  # a mask of noise of 20 megapixels at one bit a pixel; those of people have 2 to 6 KB
AFTER_STAMP = 4 + 8  # bytes: what leads in, and the stamp of a header (CDR: OMG DDS-XTypes 1.3, 7.4.3)
_COUNTED = {"position": MOST_JOINTS, "name": MOST_JOINTS, "joint_names": MOST_JOINTS, "transforms": MOST_JOINTS}


def oversize(message: Any) -> str:
    """Return what in a message is larger than any node sends; empty when nothing is."""
    data = getattr(message, "data", ())
    most = MOST_TEXT_BYTES if isinstance(data, str) else MOST_CLOUD_BYTES
    size = len(data) * getattr(data, "itemsize", 1)
    if size > most:
        return f"{size} bytes of data, at most {most} are taken"
    for name, most in _COUNTED.items():
        if len(getattr(message, name, ())) > most:
            return f"{len(getattr(message, name))} entries of {name}, at most {most} are taken"
    return ""


def check_mask_bytes(count: int, where: str) -> None:
    """Raises InputError for a camera's message that is larger than any silhouette or camera_info."""
    if count > MOST_MASK_BYTES:
        what = f"a message of {count} bytes, at most {MOST_MASK_BYTES} are taken"
        raise InputError(what, where=where, remedy="Check what publishes there.")


def read_message(message: bytes, kind: type[T]) -> T:
    """Read a serialised message of any type. Raises InputError for bytes that are none."""
    try:
        return deserialize_message(message, kind)
    except Exception as error:  # whatever the middleware raises
        what = f"{len(message)} bytes are no {kind.__name__} ({error})"
        raise InputError(what, remedy="The message is damaged; check the network and its publisher.") from None


def same_but_for_stamp(message: bytes, other: bytes | None) -> bool:
    """Whether two serialised messages that start with a header are equal but for their stamps."""
    return other is not None and message[AFTER_STAMP:] == other[AFTER_STAMP:]
