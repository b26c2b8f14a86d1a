"""Answers of cameras to a discovery, laid out by hand as the standard says."""

import ipaddress

from gige_vision.gvcp import AcknowledgePacket


def discovery_answer(address, serial="", user_id="", mac=bytes(6), subnet_mask="255.0.0.0", request_id=1):
    """The acknowledge of a camera "Maker M" at an address, as it travels."""
    record = bytearray(0xF8)
    texts = {0x48: "Maker", 0x68: "M", 0xD8: serial, 0xE8: user_id}
    addresses = {0x24: address, 0x34: subnet_mask}
    fields = {place: text.encode() for place, text in texts.items()}
    fields |= {place: ipaddress.IPv4Address(text).packed for place, text in addresses.items()}
    for place, field in {0x0A: mac, **fields}.items():
        record[place : place + len(field)] = field
    return AcknowledgePacket(0x0003, bytes(record), request_id).encode()
