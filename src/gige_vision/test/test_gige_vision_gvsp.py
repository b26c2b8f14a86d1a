"""GVSP packets and pixel formats against byte strings laid out by hand from the standard, and there and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gige_vision.gvcp import MalformedPacket, Status
from gige_vision.gvsp import (
    Content,
    ImageLeader,
    ImageTrailer,
    PacketHeader,
    Payload,
    encode_chunk,
    next_block_id,
    payload_capacity,
)
from gige_vision.pixel_formats import PixelFormat

words = st.integers(0, 2**32 - 1)


def hexed(text):
    return bytes.fromhex(text.replace(" ", ""))


def test_packet_header_is_status_block_format_and_packet_id():
    assert PacketHeader(Content.PAYLOAD, 0x0102, 0x030405).encode() == hexed("0000 0102 03 030405")
    assert PacketHeader(Content.LEADER, 1, 0, Status.PACKET_RESEND).encode() == hexed("0100 0001 01 000000")


def test_image_leader_is_36_bytes_in_the_standard_s_order():
    leader = ImageLeader(0x0000_0001_0000_0002, PixelFormat.Mono8, 640, 480, 16, 8)
    body = hexed("0000 0001 0000000100000002 01080001 00000280 000001E0 00000010 00000008 0000 0000")
    assert leader.encode() == body
    assert len(body) == 36


def test_trailers_with_and_without_chunks():
    assert ImageTrailer(480).encode() == hexed("0000 0001 000001E0")
    assert ImageTrailer(480, 0x100).encode() == hexed("0000 4001 00000100 000001E0 00000000")


def test_chunk_ends_with_its_id_and_length():
    assert encode_chunk(0x0A01, b"\1\2\3\4") == hexed("01020304 00000A01 00000004")


def test_capacity_leaves_room_for_ip_udp_and_gvsp():
    assert payload_capacity(1500) == 1464


def test_block_ids_of_16_bits_start_again_at_one():
    assert next_block_id(0xFFFF) == 1


@pytest.mark.parametrize(
    ("name", "code", "size"),
    [
        ("Mono8", 0x01080001, 24),
        ("Mono10Packed", 0x010C0004, 36),
        ("Mono12Packed", 0x010C0006, 36),
        ("Mono10p", 0x010A0046, 30),
        ("Mono12p", 0x010C0047, 36),
        ("Mono12", 0x01100005, 48),
        ("BayerRG8", 0x01080009, 24),
        ("RGB8", 0x02180014, 72),
        ("BGR8", 0x02180015, 72),
        ("YUV422_8", 0x02100032, 48),
    ],
)
def test_pixel_formats_have_their_standard_codes_and_sizes(name, code, size):
    assert PixelFormat[name] == code
    assert PixelFormat[name].image_bytes(6, 4) == size


def test_packed_image_with_an_odd_number_of_pixels_ends_with_two_bytes():
    assert PixelFormat.Mono12Packed.image_bytes(3, 1) == 5


@given(st.sampled_from(Content), st.integers(0, 2**16 - 1), st.integers(0, 2**24 - 1))
def test_any_packet_header_comes_back_as_it_was(content, block_id, packet_id):
    header = PacketHeader(content, block_id, packet_id, Status.SUCCESS)
    assert PacketHeader.decode(header.encode() + b"rest") == (header, b"rest")


@given(st.integers(0, 2**64 - 1), words, words, words, words, words, st.sampled_from([1, 0x4001]))
def test_any_image_leader_comes_back_as_it_was(timestamp, code, width, height, x, y, payload):
    leader = ImageLeader(timestamp, code, width, height, x, y, payload=payload)
    assert ImageLeader.decode(leader.encode()) == leader


@given(words, st.none() | words)
def test_any_trailer_comes_back_as_it_was(height, chunk_bytes):
    assert ImageTrailer.decode(ImageTrailer(height, chunk_bytes).encode()) == ImageTrailer(height, chunk_bytes)


@pytest.mark.parametrize("decode", [PacketHeader.decode, ImageLeader.decode, ImageTrailer.decode])
def test_packet_that_is_too_short_is_malformed(decode):
    with pytest.raises(MalformedPacket):
        decode(b"\0\0\0")


def test_chunk_payload_type_is_the_image_type_with_the_chunk_flag():
    assert Payload.IMAGE_WITH_CHUNKS == Payload.IMAGE | 0x4000
