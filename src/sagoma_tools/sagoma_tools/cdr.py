"""Serialized messages (CDR) with their undefined bytes set to zero, so that equal messages are equal bytes.

CDR aligns every number to its size; what lies in the gaps is whatever the sender's memory held.
"""

from __future__ import annotations

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)


def canonical_bytes(data: bytes, msgtype: str) -> bytes:
    """The message with zeros in its gaps; unchanged when it is of a type that is not known or does not parse."""
    try:
        return bytes(TYPES.serialize_cdr(TYPES.deserialize_cdr(data, msgtype), msgtype))
    except (SerdeError, TypesysError, KeyError):
        return data
