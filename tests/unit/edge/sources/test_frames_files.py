"""Pictures from folders and videos: order, time, and what is missing."""

import threading
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.base.errors import InputError
from trigpoint.edge.sources.frames import (
    SOURCES,
    Frame,
    Unreadable,
    open_source,
    source_class,
)
from trigpoint.edge.sources.frames_video import Video
from trigpoint.site.config import CameraConfig

START_NS = 1_700_000_000_000_000_000


def write_pictures(folder: Path, count: int = 4) -> Path:
    """Pictures whose brightness tells their number."""
    folder.mkdir(exist_ok=True)
    for number in range(count):
        cv2.imwrite(str(folder / f"{number:02d}.png"), np.full((48, 64), 40 * number, np.uint8))
    return folder


def write_video(file: Path, count: int = 6, rate: float = 5.0) -> Path:
    """A video whose brightness tells the picture's number."""
    code = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(file), code, rate, (64, 48))
    for number in range(count):
        writer.write(np.full((48, 64, 3), 40 * number % 256, np.uint8))
    writer.release()
    return file


def frames_of(
    url: str,
    *,
    clock: ManualClock,
    rate: float = 5.0,
    directory: Path = Path(),
    busy_s: float = 0.0,
) -> tuple[list[Frame], int]:
    """All frames of a source for a taker that needs `busy_s` for each, and how many it missed."""
    source = open_source(url, CameraConfig(url, rate=rate), clock=clock, directory=directory)
    frames = []
    for frame in source.frames(threading.Event()):
        if isinstance(frame, Frame):
            frames.append(frame)
        clock.advance(busy_s)
    source.close()
    return frames, source.skipped


def numbers(frames: Iterable[Frame | Unreadable | None]) -> list[int]:
    pictures = [frame.picture for frame in frames if isinstance(frame, Frame)]
    return [round(float(picture.mean()) / 40) for picture in pictures]


def test_pictures_of_a_folder_come_in_order_at_the_cameras_rate(tmp_path: Path) -> None:
    write_pictures(tmp_path)
    frames, skipped = frames_of(f"dir://{tmp_path}", clock=ManualClock(START_NS))
    assert numbers(frames) == [0, 1, 2, 3]
    assert [frame.captured_ns - START_NS for frame in frames] == [to_ns(0.2 * i) for i in range(4)]
    assert skipped == 0


def test_slow_taker_gets_every_picture_of_a_folder_later(tmp_path: Path) -> None:
    write_pictures(tmp_path)
    frames, skipped = frames_of(f"dir://{tmp_path}", clock=ManualClock(START_NS), busy_s=1.0)
    assert (numbers(frames), skipped) == ([0, 1, 2, 3], 0)
    assert frames[-1].captured_ns - START_NS == to_ns(3.0)


def test_video_plays_at_its_own_rate(tmp_path: Path) -> None:
    file = write_video(tmp_path / "clip.avi")
    frames, skipped = frames_of(f"file://{file}", clock=ManualClock(START_NS), rate=30.0)
    assert (numbers(frames), skipped) == ([0, 1, 2, 3, 4, 5], 0)
    times = [frame.captured_ns - START_NS for frame in frames]
    assert times == [to_ns(0.2 * i) for i in range(6)]


def test_slow_taker_misses_pictures_of_a_video_and_they_are_counted(tmp_path: Path) -> None:
    file = write_video(tmp_path / "clip.avi")
    clock = ManualClock(START_NS)
    frames, skipped = frames_of(f"file://{file}", clock=clock, busy_s=0.55)
    assert len(frames) + skipped == 6
    assert skipped >= 2
    assert numbers(frames) == sorted(set(numbers(frames)))
    for frame in frames:
        assert clock.now_ns() > frame.captured_ns


def test_paths_start_from_the_sites_folder(tmp_path: Path) -> None:
    write_pictures(tmp_path / "shots")
    write_video(tmp_path / "clip.avi")
    for url, count in (("dir://shots", 4), ("file://clip.avi", 6)):
        frames, _ = frames_of(url, clock=ManualClock(START_NS), directory=tmp_path)
        assert len(frames) == count


@pytest.mark.parametrize("kind", ["dir", "file"])
def test_source_ends_when_told(tmp_path: Path, kind: str) -> None:
    write_pictures(tmp_path / "shots")
    write_video(tmp_path / "clip.avi")
    url = {"dir": "dir://shots", "file": "file://clip.avi"}[kind]
    clock, stopping = ManualClock(START_NS), threading.Event()
    source = open_source(url, CameraConfig(url, rate=5.0), clock=clock, directory=tmp_path)
    taken = 0
    for _ in source.frames(stopping):
        taken += 1
        if taken == 2:
            stopping.set()
    source.close()
    assert taken == 2


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("file://none.mp4", r"none\.mp4: there is no such video"),
        ("file://text.mp4", r"text\.mp4: this is no video"),
        ("file://shots", "shots: this is a folder; write dir://"),
        ("file:///dev/null", "/dev/null: this is no file, so no video"),
        ("dir://none", "none: there is no such folder"),
        ("dir://empty", "empty: no pictures"),
        ("dir://shots?lop=1", "no option «lop»; did you mean «loop»"),
        ("dir://shots?loop=yes", "loop is «yes»; write loop=1"),
        ("dir://shots?loop=1&follow=1", "not both"),
        ("ftp://host/clip.mp4", r"«ftp://» are not known.*file://.*sim://"),
    ],
)
def test_source_that_cannot_be_is_said_in_one_line(tmp_path: Path, url: str, said: str) -> None:
    write_pictures(tmp_path / "shots")
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(InputError, match=said) as caught:
        open_source(url, CameraConfig(url), clock=ManualClock(), directory=tmp_path)
    assert "\n" not in str(caught.value)


def test_damaged_picture_in_a_folder_is_left_out_counted_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_pictures(tmp_path)
    whole, _ = frames_of(f"dir://{tmp_path}", clock=ManualClock())
    (tmp_path / "02.png").write_bytes((tmp_path / "02.png").read_bytes()[:40])
    url = f"dir://{tmp_path}"
    source = open_source(url, CameraConfig(url), clock=ManualClock(), directory=Path())
    found = list(source.frames(threading.Event()))
    assert [isinstance(frame, Frame) for frame in found] == [True, True, False, True]
    assert len(whole) == 4
    assert "02.png: the picture is cut short" in caplog.text


def test_folder_without_a_picture_that_can_be_read_is_said(tmp_path: Path) -> None:
    (tmp_path / "01.png").write_bytes(b"\x89PNG")
    with pytest.raises(InputError, match=r"01\.png: the picture is cut short"):
        frames_of(f"dir://{tmp_path}", clock=ManualClock())


def test_folder_that_loops_begins_again(tmp_path: Path) -> None:
    write_pictures(tmp_path)
    url = f"dir://{tmp_path}?loop=1"
    source = open_source(url, CameraConfig(url), clock=ManualClock(), directory=Path())
    frames = [frame for frame in islice(source.frames(threading.Event()), 9) if frame]
    assert numbers(frames) == [0, 1, 2, 3, 0, 1, 2, 3, 0]


def test_folder_that_loops_keeps_its_pace_where_its_pictures_are_spoilt_meanwhile(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_pictures(tmp_path)
    url, clock = f"dir://{tmp_path}?loop=1", ManualClock()
    source = open_source(url, CameraConfig(url, rate=5.0), clock=clock, directory=Path())
    frames = source.frames(threading.Event())
    assert isinstance(next(frames), Frame)
    for file in tmp_path.iterdir():
        file.write_bytes(b"\x89PNG")
    spoilt = [frame for frame in islice(frames, 20) if isinstance(frame, Unreadable)]
    assert len(spoilt) == 20
    assert "cut short" in spoilt[-1].reason
    assert clock.elapsed_ns() == pytest.approx(to_ns(20 * 0.2))
    assert caplog.text.count("it is left out") == 4  # each file once
    write_pictures(tmp_path)
    assert isinstance(next(frames), Frame)


def test_folder_that_loops_ends_where_nothing_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "01.png").write_bytes(b"\x89PNG")
    with pytest.raises(InputError, match=r"01\.png: the picture is cut short"):
        frames_of(f"dir://{tmp_path}?loop=1", clock=ManualClock())


def test_followed_folder_gives_each_picture_once_when_it_is_whole(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shots = write_pictures(tmp_path / "made")
    (folder := tmp_path / "shots").mkdir()
    url, clock = f"dir://{folder}?follow=1", ManualClock(START_NS)
    source = open_source(url, CameraConfig(url), clock=clock, directory=Path())
    found = source.frames(threading.Event())
    data = [file.read_bytes() for file in sorted(shots.iterdir())]
    assert next(found) is None
    (folder / "0.png").write_bytes(data[0])
    (folder / "1.png").write_bytes(data[1][:40])
    assert numbers(islice(found, 4)) == [0]
    (folder / "1.png").write_bytes(data[1])
    (folder / "2.png").write_bytes(data[2][:40])  # and is never written on
    assert numbers(islice(found, 4)) == [1]
    assert "left out" not in caplog.text
    found_spoilt = [frame for frame in islice(found, 15) if frame is not None]
    assert [isinstance(frame, Unreadable) for frame in found_spoilt] == [True]
    assert "2.png: the picture is cut short" in caplog.text
    (folder / "3.png").write_bytes(data[3])
    assert numbers(islice(found, 4)) == [3]


@pytest.mark.parametrize("follow", ["", "?follow=1"])
def test_folder_whose_pictures_exif_turns_differently_is_refused(
    tmp_path: Path, follow: str
) -> None:
    write_pictures(tmp_path, 1)
    picture = np.full((48, 64), 80, np.uint8)
    exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    given = [np.frombuffer(exif, np.uint8)]
    turned = cv2.imencodeWithMetadata(".png", picture, [cv2.IMAGE_METADATA_EXIF], given)[1]
    (tmp_path / "01.png").write_bytes(turned.tobytes())
    with pytest.raises(InputError, match="EXIF"):
        frames_of(f"dir://{tmp_path}{follow}", clock=ManualClock())


def test_every_scheme_of_the_table_and_every_plug_in_can_be_loaded() -> None:
    for scheme in (*SOURCES, "sim"):
        assert callable(source_class(scheme))


def test_pictures_of_a_video_that_cannot_be_decoded_are_told_and_the_others_keep_their_time(
    tmp_path: Path,
) -> None:
    file = write_video(tmp_path / "clip.avi")
    with av.open(str(file)) as container:
        places = [(p.pos, p.size) for p in container.demux(video=0) if p.pos is not None]
    data = bytearray(file.read_bytes())
    for number in (0, 2, 3):
        pos, size = places[number]
        data[pos : pos + size] = bytes(size)
    file.write_bytes(data)
    url, clock = f"file://{file}", ManualClock(START_NS)
    source = open_source(url, CameraConfig(url, rate=5.0), clock=clock, directory=Path())
    found = list(source.frames(threading.Event()))
    source.close()
    assert [isinstance(one, Unreadable) for one in found] == [True, False, True, True, False, False]
    assert numbers(found) == [1, 4, 5]
    stamps = [one.captured_ns - START_NS for one in found if isinstance(one, Frame)]
    assert stamps == [to_ns(0.2 * number) for number in (0, 3, 4)]
    assert source.skipped == 0


def test_time_of_a_video_always_rises(tmp_path: Path) -> None:
    video = Video(write_video(tmp_path / "clip.avi", count=12, rate=25.0))
    times = []
    while (position_ns := video.advance()) is not None:
        times.append(position_ns)
    video.close()
    assert len(times) == 12
    assert times[0] == 0
    assert np.all(np.diff(times) > 0)
