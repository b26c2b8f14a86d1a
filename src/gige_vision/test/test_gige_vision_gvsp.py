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
    encode_chunk,
    next_block_id,
    payload_capacity,
)
from gige_vision.pixel_formats import PixelFormat

words = st.integers(0, 2**32 - 1)


def hexed(text):
    return bytes.fromhex(text.replace(" ", ""))


@pytest.mark.parametrize(
    ("encoded", "laid_out"),
    [
        (PacketHeader(Content.PAYLOAD, 0x0102, 0x030405).encode(), "0000 0102 03 030405"),
        (PacketHeader(Content.LEADER, 1, 0, Status.PACKET_RESEND).encode(), "0100 0001 01 000000"),
        (
            ImageLeader(0x0000_0001_0000_0002, PixelFormat.Mono8, 640, 480, 16, 8).encode(),
            "0000 0001 0000000100000002 01080001 00000280 000001E0 00000010 00000008 0000 0000",
        ),
        (ImageTrailer(480).encode(), "0000 0001 000001E0"),
        (ImageTrailer(480, 0x100).encode(), "0000 4001 00000100 000001E0 00000000"),
        (encode_chunk(0x0A01, b"\1\2\3\4"), "01020304 00000A01 00000004"),
    ],
    ids=["header", "header of a resent packet", "leader", "trailer", "trailer with chunks", "chunk"],
)
def test_packet_is_laid_out_as_the_standard_says(encoded, laid_out):
    assert encoded == hexed(laid_out)


def test_capacity_leaves_room_for_headers_and_block_ids_of_16_bits_start_again_at_one():
    assert payload_capacity(1500) == 1464
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


@given(
    st.builds(ImageLeader, st.integers(0, 2**64 - 1), *[words] * 5, payload=st.sampled_from([1, 0x4001]))
    | st.builds(ImageTrailer, words, st.none() | words)
)
def test_any_leader_and_trailer_comes_back_as_it_was(packet):
    assert type(packet).decode(packet.encode()) == packet


@pytest.mark.parametrize("decode", [PacketHeader.decode, ImageLeader.decode, ImageTrailer.decode])
def test_packet_that_is_too_short_is_malformed(decode):
    with pytest.raises(MalformedPacket):
        decode(b"\0\0\0")
