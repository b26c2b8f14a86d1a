"""GVCP packets against byte strings laid out by hand from the standard, and there and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gige_vision import gvcp as gvcp_payloads
from gige_vision.gvcp import (
    AcknowledgePacket,
    Action,
    Command,
    CommandPacket,
    DeviceRecord,
    MalformedPacket,
    ResendRequest,
    Status,
    encode_text,
)

words = st.integers(0, 2**32 - 1)
halves = st.integers(0, 2**16 - 1)


def hexed(text):
    return bytes.fromhex(text.replace(" ", ""))


def test_discovery_command_is_eight_bytes_with_key_and_acknowledge_flag():
    assert CommandPacket(Command.DISCOVERY, request_id=0x1234).encode() == hexed("42 01 0002 0000 1234")


def test_register_read_is_laid_out_as_the_standard_says():
    command = CommandPacket(Command.READ_REGISTER, gvcp_payloads.encode_words([0x0A00]), 7)
    assert command.encode() == hexed("42 01 0080 0004 0007 00000A00")
    answer = AcknowledgePacket(Command.READ_REGISTER.acknowledge, gvcp_payloads.encode_words([2]), 7)
    assert answer.encode() == hexed("0000 0081 0004 0007 00000002")


def test_register_write_is_laid_out_as_the_standard_says():
    command = CommandPacket(Command.WRITE_REGISTER, gvcp_payloads.encode_writes([(0x0A00, 2)]), 8)
    assert command.encode() == hexed("42 01 0082 0008 0008 00000A00 00000002")


def test_memory_read_carries_its_count_in_the_last_two_bytes():
    command = CommandPacket(Command.READ_MEMORY, gvcp_payloads.encode_memory_read(0x0200, 512), 9)
    assert command.encode() == hexed("42 01 0084 0008 0009 00000200 0000 0200")


def test_denied_access_is_an_acknowledge_with_status_8006():
    answer = AcknowledgePacket.decode(hexed("8006 0083 0004 0001 00000000"))
    assert answer.status == Status.ACCESS_DENIED


def test_resend_request_asks_for_no_acknowledge():
    command = ResendRequest(block_id=0x0102, first=3, last=5).command(request_id=4)
    assert command.encode() == hexed("42 00 0040 000C 0004 0000 0102 00000003 00000005")


def test_scheduled_action_has_flag_80_and_the_time_behind_the_keys():
    command = Action(0x11, 0x22, 0x4, time_ns=0x0123_4567_89AB_CDEF).command(request_id=1)
    assert command.encode() == hexed("42 81 0100 0014 0001 00000011 00000022 00000004 0123456789ABCDEF")
    assert Action(0x11, 0x22, 0x4).command().encode() == hexed("42 01 0100 000C 0001 00000011 00000022 00000004")


def test_discovery_record_has_every_field_at_its_standard_place():
    record = DeviceRecord(
        address="127.0.11.1",
        manufacturer="Sagoma",
        model="Studio",
        device_version="1.0",
        manufacturer_info="info",
        serial="S1",
        user_id="cam01",
        mac=bytes.fromhex("020000000b01"),
        subnet_mask="255.0.0.0",
        gateway="10.0.0.1",
    ).encode()
    assert len(record) == 0xF8
    assert record[0x00:0x08] == hexed("00020000 80000001")
    assert record[0x0A:0x10] == hexed("020000000b01")
    assert record[0x24:0x28] == bytes([127, 0, 11, 1])
    assert record[0x34:0x38] == bytes([255, 0, 0, 0])
    assert record[0x44:0x48] == bytes([10, 0, 0, 1])
    assert record[0x48:0x50] == b"Sagoma\0\0"
    assert record[0x68:0x70] == b"Studio\0\0"
    assert record[0x88:0x8C] == b"1.0\0"
    assert record[0xA8:0xAD] == b"info\0"
    assert record[0xD8:0xDB] == b"S1\0"
    assert record[0xE8:0xF8] == b"cam01".ljust(16, b"\0")


@given(st.integers(0, 0xFFFF), st.binary(max_size=536), halves, st.integers(0, 255))
def test_any_command_comes_back_as_it_was(command, payload, request_id, flags):
    packet = CommandPacket(command, payload, request_id, flags)
    assert CommandPacket.decode(packet.encode()) == packet


@given(halves, st.binary(max_size=536), halves, halves)
def test_any_acknowledge_comes_back_as_it_was(acknowledge, payload, request_id, status):
    packet = AcknowledgePacket(acknowledge, payload, request_id, status)
    assert AcknowledgePacket.decode(packet.encode()) == packet


@given(st.lists(words, min_size=1), st.lists(st.tuples(words, words), min_size=1), st.binary(), words, halves)
def test_register_payloads_come_back_as_they_were(values, writes, data, address, count):
    assert gvcp_payloads.decode_words(gvcp_payloads.encode_words(values)) == tuple(values)
    assert gvcp_payloads.decode_writes(gvcp_payloads.encode_writes(writes)) == tuple(writes)
    assert gvcp_payloads.decode_memory(gvcp_payloads.encode_memory(address, data)) == (address, data)
    assert gvcp_payloads.decode_memory_read(gvcp_payloads.encode_memory_read(address, count)) == (address, count)


@given(words, words, words, st.none() | st.integers(0, 2**64 - 1))
def test_any_action_comes_back_as_it_was(device_key, group_key, mask, time_ns):
    action = Action(device_key, group_key, mask, time_ns)
    assert Action.decode(CommandPacket.decode(action.command().encode())) == action


@given(st.integers(1, 2**16 - 1), st.integers(0, 2**24 - 1), st.integers(0, 2**24 - 1))
def test_any_resend_request_comes_back_as_it_was(block_id, first, last):
    request = ResendRequest(block_id, first, last)
    assert ResendRequest.decode(CommandPacket.decode(request.command().encode())) == request


@given(st.text(max_size=40), st.integers(4, 48))
def test_texts_are_cut_at_a_character_and_always_end_with_zero(text, size):
    data = encode_text(text, size)
    assert len(data) == size and data[-1] == 0
    assert text.encode().startswith(data.rstrip(b"\0").decode().encode().rstrip(b"\0"))


@given(st.binary(max_size=7))
def test_packet_shorter_than_its_header_is_malformed(data):
    with pytest.raises(MalformedPacket):
        CommandPacket.decode(data)
    with pytest.raises(MalformedPacket):
        AcknowledgePacket.decode(data)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("41 01 0002 0000 0001", "begins with 0x42"), ("42 01 0080 0008 0001 00000000", "promises 8 bytes, 4 follow")],
)
def test_command_that_contradicts_itself_is_malformed(text, reason):
    with pytest.raises(MalformedPacket, match=reason):
        CommandPacket.decode(hexed(text))


@pytest.mark.parametrize("decode", [gvcp_payloads.decode_words, gvcp_payloads.decode_writes, DeviceRecord.decode])
def test_payload_of_a_wrong_length_is_malformed(decode):
    for payload in (b"", bytes(3), bytes(6)):
        with pytest.raises(MalformedPacket):
            decode(payload)
