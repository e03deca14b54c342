"""What the agent of a camera sends, and when."""

import json
import logging
import threading
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from support.builders import eventually
from support.pictures.boards import (
    charuco,
    checkerboard,
    picture_of,
    placed,
    target_of,
    worst_error,
)
from support.pictures.rooms import room
from support.site.edge_desk import EMPTY, SEEN, VIEW, Desk, desk, taken

from benchmarks.pictures.still_scene import Stand, StillScene
from trigpoint.base.clock import ManualClock
from trigpoint.contract.messages import Picture, Sightings
from trigpoint.contract.topics import IMAGE, SIGHTINGS, command_key
from trigpoint.edge.sources.frames import Frame, Unreadable

__all__ = ["desk"]  # the fixture


def difference(jpeg: bytes, picture: np.ndarray) -> float:
    """The mean difference of a JPEG from a grey picture, grey levels."""
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    return float(np.abs(shown.astype(int) - picture).mean())


def test_every_picture_gives_sightings_also_where_there_are_none(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    node = desk.start((1000, EMPTY), (2000, SEEN), (3000, EMPTY))
    node.wait()
    sightings = [message for message in taken(ears) if isinstance(message, Sightings)]
    assert [(s.stamp_ns, s.width, s.height, len(s.faces)) for s in sightings] == [
        (1000, 640, 480, 0),
        (2000, 640, 480, 1),
        (3000, 640, 480, 0),
    ]
    assert {s.frame_id for s in sightings} == {"c1/optical"}
    (face,) = sightings[1].faces
    assert worst_error(face.pixels, face.corners, VIEW) < 0.3
    assert node.health.total("sent lab/camera/c1/sightings") == 3
    assert node.health.total("faces") == 1


def held_back(until: threading.Event) -> Iterator[Frame]:
    until.wait()
    yield Frame(EMPTY, 1)


def test_clock_that_is_off_is_told_by_the_camera_itself(desk: Desk) -> None:
    waits = threading.Event()
    desk.bus.serve(
        "lab/clock", lambda _: json.dumps({"now_ns": time.time_ns() - 1_050_000_000}).encode()
    )
    node = desk.start(script=held_back(waits))
    # It is certain to half a round trip: 1.05 s is told as 1.0… of any shorter than 0.1 s.
    assert eventually(lambda: "clock is 1.0" in node.health.last_error)
    assert (
        "s ahead of fusion's, where 0.006 s are borne: from 3 times that on, what camera c1 sees "
        "is not used beside clocks that are right" in node.health.last_error
    )
    waits.set()


def test_source_that_gives_nothing_readable_is_said_until_it_does(desk: Desk) -> None:
    spoilt, goes_on = threading.Event(), threading.Event()

    def script() -> Iterator[Frame | Unreadable]:
        yield Frame(EMPTY, 1)
        yield Unreadable("01.png is cut short")
        clock.advance(5.0)
        yield Unreadable("02.png is cut short")
        spoilt.set()
        goes_on.wait()
        yield Frame(EMPTY, 2)

    clock = ManualClock(10**18)
    node = desk.start(script=script(), clock=clock)
    assert spoilt.wait(10.0)
    assert node.health.held["source"] == (
        "camera c1: no picture that can be read for 5 s; 02.png is cut short"
    )
    assert node.health.lost("unreadable") == 2
    goes_on.set()
    node.wait()
    assert node.health.held == {}


def test_one_spoilt_picture_of_a_slow_source_is_no_error_nor_are_several_while_it_waits(
    desk: Desk,
) -> None:
    said, has_started = [], threading.Event()

    def script() -> Iterator[Frame | Unreadable | None]:
        has_started.wait()
        for after_s, item in (
            (0.0, Frame(EMPTY, 1)),
            (60.0, Unreadable("02.png is cut short")),
            (0.2, None),
            (60.0, Frame(EMPTY, 2)),
            (60.0, Unreadable("04.png is cut short")),
            (60.0, Unreadable("05.png is cut short")),
            (0.2, None),
        ):
            clock.advance(after_s)
            yield item
            said.append(node.health.held)

    clock = ManualClock(10**18)
    node = desk.start(script=script(), clock=clock)
    has_started.set()
    node.wait()
    assert [held.get("source") for held in said] == [
        *[None] * 5,
        "camera c1: no picture that can be read for 60 s; 05.png is cut short",
        None,
    ]


def test_picture_that_takes_longer_than_a_period_is_given_up_and_counted(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    node = desk.start((1000, SEEN), (2000, SEEN), camera="rate = 1e6")
    node.wait()
    assert len(taken(ears)) == 2
    assert node.health.lost("given_up") == 2


def test_board_that_the_file_describes_the_wrong_way_round_is_said(desk: Desk) -> None:
    picture = picture_of([placed(checkerboard(8, 6))])
    node = desk.start(
        *((1000 * i, picture) for i in range(1, 5)),
        target=target_of(checkerboard(6, 8)),
        camera="rate = 0.01",
    )
    node.wait()
    assert "write columns = 8 and rows = 6" in node.health.held["target file"]


def test_board_of_another_size_is_said_until_the_files_own_is_seen(desk: Desk) -> None:
    has_started, own = threading.Event(), charuco(5, 4)

    def script() -> Iterator[Frame]:
        has_started.wait()
        for number, face in enumerate((charuco(9, 6), own), 1):
            yield Frame(picture_of([placed(face, distance=1.0)]), number * 10**11)
            is_said = face is not own
            assert eventually(lambda wanted=is_said: ("target file" in node.health.held) is wanted)

    node = desk.start(script=script(), target=target_of(own), camera="rate = 0.01")
    has_started.set()
    node.wait()
    assert node.health.total("faces") == 1
    assert "target file" not in node.health.held


def test_pictures_are_only_sent_while_somebody_listens(desk: Desk) -> None:
    node = desk.start((1000, EMPTY), (2_000_000_000, EMPTY))
    node.wait()
    assert node.health.total("sent lab/camera/c1/image/compressed") == 0


def test_pictures_are_sent_at_their_own_rate(desk: Desk) -> None:
    ears = desk.listen(IMAGE)
    tenths = [(1 + i * 100_000_000, SEEN) for i in range(20)]
    node = desk.start(*tenths, camera="picture_rate = 2.5")
    node.wait()
    pictures = [message for message in taken(ears) if isinstance(message, Picture)]
    assert node.health.total("sent lab/camera/c1/image/compressed") == 5
    assert [picture.stamp_ns for picture in pictures] == [1 + i * 400_000_000 for i in range(1, 5)]
    assert difference(pictures[0].data, SEEN) < 5


def test_snapshot_is_the_latest_picture(desk: Desk) -> None:
    has_begun, may_end = threading.Event(), threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        has_begun.wait(60.0)
        yield 1000, SEEN
        may_end.wait(60.0)

    node = desk.start(script=script())
    key = command_key("lab", "camera/c1/snapshot")
    (refusal,) = desk.bus.query(key)
    assert "no picture yet" in refusal.error
    has_begun.set()
    assert eventually(lambda: node.health.total("sent lab/camera/c1/sightings") == 1)
    (reply,) = desk.bus.query(key)
    may_end.set()
    node.wait()
    assert difference(reply.payload, SEEN) < 5


def test_age_of_the_newest_picture_grows_where_the_camera_is_frozen(desk: Desk) -> None:
    clock = ManualClock()

    def script() -> Iterator[tuple[int, np.ndarray] | Frame]:
        clock.advance(2.0)
        yield 1000, EMPTY
        clock.advance(3.0)
        yield Frame(EMPTY, 2000, is_frozen=True)
        clock.advance(4.0)

    node = desk.start(script=script(), clock=clock)
    node.wait()
    assert node.health.report().values["picture_age_s"] == "7"


def test_target_is_said_when_it_is_first_seen_and_all_is_summed_up(
    desk: Desk, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "trigpoint")
    # A picture in which a busy machine found no time is one without.
    pictures = [(number * 10**9, SEEN) for number in range(2, 12)]
    desk.start((10**9, EMPTY), *pictures).wait()
    assert caplog.text.count("camera c1 sees the target: 1 face, in picture ") == 1
    assert "camera c1: its source has come to its end" in caplog.text
    assert eventually(lambda: "camera c1: 11 pictures, " in caplog.text)


def test_camera_that_is_turned_is_in_the_diagnostics_until_the_end(desk: Desk) -> None:
    scene = StillScene(room(1), np.random.default_rng(1), width=640, height=480)
    stands = [Stand()] * 40 + [Stand(pan=0.5)] * 5
    pictures = [(number * 10**9, scene.picture(stand)) for number, stand in enumerate(stands, 1)]
    node = desk.start(*pictures, camera="rate = 1.0\nnotice_nudges = true")
    node.wait()
    values = node.health.report().values
    assert values["nudges.total"] == "1"
    assert values["nudged_between"] == f"{40 * 10**9} {41 * 10**9}"
    assert values["background"] == "still"
    assert "camera c1 was turned or shifted" in values["last_error"]
    assert "degrees" in values["last_error"]


def test_camera_that_nobody_touches_says_so(desk: Desk) -> None:
    node = desk.start((1000, EMPTY), (2000, EMPTY), camera="notice_nudges = true")
    node.wait()
    values = node.health.report().values
    assert values["nudges.total"] == "0"
    assert values["background"] == "learning"
    assert "nudged_between" not in values


def test_calibration_can_be_asked_for(desk: Desk) -> None:
    may_end = threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        yield 1000, SEEN
        may_end.wait(60.0)

    node = desk.start(script=script())
    assert eventually(lambda: node.health.report().values["calibration_views"] == "1")
    (reply,) = desk.bus.query(command_key("lab", "camera/c1/calibrate"))
    may_end.set()
    node.wait()
    assert "1 view of the target was found" in reply.error
