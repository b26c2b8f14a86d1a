"""A reader of Open Sound Control 1.0 that shares no code with the sender."""

import struct


def text_of(data: bytes) -> tuple[str, bytes]:
    end = data.index(b"\0")
    return data[:end].decode("ascii"), data[(end // 4 + 1) * 4 :]


def osc_messages(datagram: bytes) -> list[tuple[str, list]]:
    """Address and values of every message of a bundle; texts, 32-bit floats and whole numbers."""
    assert datagram[:8] == b"#bundle\0"
    said, rest = [], datagram[16:]
    while rest:
        (size,) = struct.unpack(">i", rest[:4])
        message, rest = rest[4 : 4 + size], rest[4 + size :]
        address, message = text_of(message)
        tags, message = text_of(message)
        values = []
        for tag in tags[1:]:
            if tag == "s":
                value, message = text_of(message)
            else:
                (value,) = struct.unpack({"f": ">f", "i": ">i"}[tag], message[:4])
                message = message[4:]
            values.append(value)
        said.append((address, values))
    return said
