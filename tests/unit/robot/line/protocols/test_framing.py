"""Frames on a serial line: any cut, noise between, damage."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.robot.line.protocol import Damaged, DamageKind
from trigpoint.robot.line.protocols import framing
from trigpoint.robot.line.protocols.framing import (
    MAXIMUM_FRAME,
    MAXIMUM_PAYLOAD,
    Frame,
    FrameReader,
    FrameWriter,
    SequenceCheck,
    crc16,
    decode_frame,
    encode_frame,
)

frames = st.builds(
    Frame,
    kind=st.integers(0, 255),
    sequence=st.integers(0, 65535),
    payload=st.binary(max_size=MAXIMUM_PAYLOAD),
)
# Bytes that hold a delimiter and can be no frame: too short for one.
short_noise = st.binary(max_size=5).map(lambda noise: noise.replace(b"\0", b"\1") + b"\0")


def cut(data: bytes, places: list[int]) -> list[bytes]:
    at = sorted({place % (len(data) + 1) for place in places})
    ends = [0, *at, len(data)]
    return [data[first:second] for first, second in pairwise(ends)]


@given(frames)
def test_frame_comes_back_as_it_was(frame: Frame) -> None:
    encoded = encode_frame(frame)
    assert encoded.index(b"\0") == len(encoded) - 1
    assert len(encoded) <= MAXIMUM_FRAME + 2
    assert decode_frame(encoded[:-1]) == frame


@given(st.lists(frames, max_size=4), st.lists(st.integers(0, 2000), max_size=12))
def test_frames_are_found_however_the_bytes_are_cut(sent: list[Frame], places: list[int]) -> None:
    reader = FrameReader()
    data = b"".join(encode_frame(frame) for frame in sent)
    assert [frame for piece in cut(data, places) for frame in reader.feed(piece)] == sent


@given(st.lists(st.tuples(frames, short_noise), min_size=1, max_size=4))
def test_noise_between_frames_loses_none_of_them(sent: list[tuple[Frame, bytes]]) -> None:
    reader = FrameReader()
    data = b"\0" + b"".join(encode_frame(frame) + noise for frame, noise in sent)
    found = reader.feed(data)
    assert [item for item in found if isinstance(item, Frame)] == [frame for frame, _ in sent]
    assert all(isinstance(item, Frame | Damaged) for item in found)
    assert sum(isinstance(item, Damaged) for item in found) == sum(
        len(noise) > 1 for _, noise in sent
    )


@given(st.binary(max_size=253))
def test_stuffing_is_undone_and_leaves_no_zero(body: bytes) -> None:
    stuffed = framing._stuffed(body)
    assert b"\0" not in stuffed
    assert len(stuffed) == len(body) + 1
    assert framing._unstuffed(stuffed) == body


@pytest.mark.parametrize(
    ("body", "stuffed"),
    [
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("00 11 00", "01 02 11 01"),
        ("11 22 00 33", "03 11 22 02 33"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
        ("45 00 00 2c 4c 79 00 00 40 06 4f 37", "02 45 01 04 2c 4c 79 01 05 40 06 4f 37"),
    ],
)
def test_stuffing_is_that_of_the_paper_and_its_followers(body: str, stuffed: str) -> None:
    """The last is Cheshire and Baker's example, the others those that every port is tried on."""
    assert framing._stuffed(bytes.fromhex(body)) == bytes.fromhex(stuffed)


@pytest.mark.parametrize("encoded", ["05 11 22", "01 00 11", "ff 11"])
def test_length_that_cannot_be_is_damage(encoded: str) -> None:
    assert decode_frame(bytes.fromhex(encoded)) == Damaged(DamageKind.FRAMING)


@given(frames, st.data())
def test_burst_of_damage_within_two_bytes_never_decodes(frame: Frame, data: st.DataObject) -> None:
    body = bytearray(framing._unstuffed(encode_frame(frame)[:-1]) or b"")
    at = data.draw(st.integers(0, len(body) - 2))
    burst = data.draw(st.binary(min_size=2, max_size=2).filter(any))
    body[at] ^= burst[0]
    body[at + 1] ^= burst[1]
    assert decode_frame(framing._stuffed(bytes(body))) == Damaged(DamageKind.CHECKSUM)


@given(st.binary(max_size=400), frames)
def test_reading_goes_on_after_any_garbage(garbage: bytes, frame: Frame) -> None:
    reader = FrameReader()
    reader.feed(garbage + b"\0")
    assert reader.feed(encode_frame(frame)) == [frame]


@given(frames, st.integers(0, 1000))
def test_rest_of_a_frame_that_began_before_is_no_damage(frame: Frame, place: int) -> None:
    encoded = encode_frame(frame)
    start = 1 + place % (len(encoded) - 1)
    reader = FrameReader()
    assert [item for item in reader.feed(encoded[start:]) if isinstance(item, Damaged)] == []


def test_endless_bytes_without_a_delimiter_are_not_kept() -> None:
    reader = FrameReader()
    reader.feed(b"\0")
    for _ in range(1000):
        assert reader.feed(b"\x55" * 100) == []
    assert len(reader._buffer) <= MAXIMUM_FRAME + 1
    assert reader.feed(b"\0") == [Damaged(DamageKind.FRAMING)]


def test_checksum_is_the_documented_one() -> None:
    assert crc16(b"123456789") == 0x29B1


def test_missing_frames_are_counted_across_the_wrap() -> None:
    check = SequenceCheck()
    assert [check.missing(number) for number in (65534, 65535, 0, 3)] == [0, 0, 0, 2]


def test_writer_numbers_its_frames() -> None:
    writer, reader = FrameWriter(), FrameReader()
    found = [reader.feed(writer.write(1, b""))[0] for _ in range(3)]
    assert [frame.sequence for frame in found if isinstance(frame, Frame)] == [0, 1, 2]
