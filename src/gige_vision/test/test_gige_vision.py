"""GVCP and GVSP packets against byte strings laid out by hand from the standard, and there and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gige_vision import gvcp, gvsp
from gige_vision.gvcp import (
    AcknowledgePacket,
    Action,
    Command,
    CommandPacket,
    DeviceRecord,
    MalformedPacket,
    Status,
    encode_text,
)
from gige_vision.gvsp import PixelFormat


def hexed(text):
    return bytes.fromhex(text.replace(" ", ""))


@pytest.mark.parametrize(
    ("packet", "laid_out"),
    [
        (CommandPacket(Command.DISCOVERY, request_id=0x1234), "42 01 0002 0000 1234"),
        (CommandPacket(Command.READ_REGISTER, gvcp.encode_words([0x0A00]), 7), "42 01 0080 0004 0007 00000A00"),
        (AcknowledgePacket(0x81, gvcp.encode_words([2]), 7), "0000 0081 0004 0007 00000002"),
        (
            CommandPacket(Command.WRITE_REGISTER, gvcp.encode_words([0x0A00, 2]), 8),
            "42 01 0082 0008 0008 00000A00 00000002",
        ),
        (
            CommandPacket(Command.READ_MEMORY, gvcp.encode_words([0x0200, 512]), 9),
            "42 01 0084 0008 0009 00000200 0000 0200",
        ),
        (
            Action(0x11, 0x22, 0x4, time_ns=0x0123_4567_89AB_CDEF).command(),
            "42 81 0100 0014 0001 00000011 00000022 00000004 0123456789ABCDEF",
        ),
    ],
    ids=str,
)
def test_packet_is_laid_out_as_the_standard_says_and_read_back(packet, laid_out):
    assert packet.encode() == hexed(laid_out)
    assert type(packet).decode(hexed(laid_out)) == packet


@pytest.mark.parametrize(
    ("packet", "laid_out"),
    [
        (gvsp.packet_header(gvsp.Content.PAYLOAD, 0x0102, 0x030405), "0000 0102 03 030405"),
        (gvsp.packet_header(gvsp.Content.LEADER, 1, 0, Status.PACKET_RESEND), "0100 0001 01 000000"),
        (
            gvsp.image_leader(0x1_0000_0002, PixelFormat.Mono8, (640, 480), (16, 8)),
            "0000 0001 0000000100000002 01080001 00000280 000001E0 00000010 00000008 0000 0000",
        ),
        (gvsp.image_trailer(480), "0000 0001 000001E0"),
    ],
)
def test_parts_of_a_stream_packet_are_laid_out_as_the_standard_says(packet, laid_out):
    assert packet == hexed(laid_out)


def test_payloads_are_read_as_the_standard_lays_them_out():
    assert gvcp.decode_words(hexed("00000A00 00000A04")) == (0xA00, 0xA04)
    assert gvcp.decode_writes(hexed("00000A00 00000002 00000D00 00000007")) == ((0xA00, 2), (0xD00, 7))
    assert gvcp.decode_memory(gvcp.encode_memory(0x200, b"text")) == (0x200, b"text")
    assert gvcp.decode_memory_read(hexed("00000200 0000 0200")) == (0x200, 512)
    assert gvcp.decode_resend(hexed("0000 0102 00000003 FF000005")) == (0x0102, 3, 5)
    action = Action(0x11, 0x22, 0x4, time_ns=0x0123_4567_89AB_CDEF)
    assert Action.decode(CommandPacket.decode(action.command().encode())) == action


def test_discovery_record_has_every_field_at_its_standard_place():
    places = {
        0x0A: hexed("020000000b01"),
        0x24: bytes([127, 0, 11, 1]),
        0x34: bytes([255, 255, 0, 0]),
        0x48: b"Sagoma",
        0x68: b"Studio",
        0xD8: b"S1",
        0xE8: b"cam01",
    }
    record = bytearray(0xF8)
    for place, field in places.items():
        record[place : place + len(field)] = field
    mac = bytes.fromhex("020000000b01")
    assert DeviceRecord.decode(bytes(record)) == DeviceRecord(
        "127.0.11.1", "Sagoma", "Studio", "S1", "cam01", mac, "255.255.0.0"
    )


@given(st.text("az\0é€😀", max_size=40), st.integers(4, 48))
def test_texts_are_cut_at_a_character_and_always_end_with_zero(text, size):
    data = encode_text(text, size)
    assert len(data) == size and data[-1] == 0
    assert text.encode().startswith(data.rstrip(b"\0").decode().encode().rstrip(b"\0"))


@pytest.mark.parametrize(
    ("decode", "data", "reason"),
    [
        *((kind.decode, bytes(size), None) for kind in (CommandPacket, AcknowledgePacket) for size in (0, 1, 7)),
        (CommandPacket.decode, hexed("41 01 0002 0000 0001"), "begins with 0x42"),
        (CommandPacket.decode, hexed("42 01 0080 0008 0001 00000000"), "promises 8 bytes, 4 follow"),
        *((d, bytes(n), None) for d in (gvcp.decode_words, gvcp.decode_writes, DeviceRecord.decode) for n in (0, 3, 6)),
        (gvcp.decode_resend, bytes(3), None),
    ],
)
def test_packet_of_a_wrong_length_or_that_contradicts_itself_is_malformed(decode, data, reason):
    with pytest.raises(MalformedPacket, match=reason):
        decode(data)


def test_capacity_leaves_room_for_headers_and_block_ids_of_16_bits_start_again_at_one():
    assert gvsp.payload_capacity(1500) == 1464
    assert gvsp.next_block_id(0xFFFF) == 1


def test_image_has_the_bytes_that_its_format_s_code_says():
    assert [PixelFormat[name].image_bytes(3, 1) for name in ("Mono8", "Mono12", "RGB8")] == [3, 6, 9]
