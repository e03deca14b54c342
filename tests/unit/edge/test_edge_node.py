"""The agent of a camera on a bus in memory: what it sends, when, and how it ends."""

import logging
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
from boards import (
    CAMERA,
    charuco,
    checkerboard,
    picture_of,
    placed,
    plain_picture,
    target_of,
    worst_error,
)
from builders import eventually

from trigpoint.bus import Subscription
from trigpoint.bus_memory import MemoryBroker
from trigpoint.camera_info import write_camera_info
from trigpoint.cdr import decode
from trigpoint.config import CameraConfig, parse_site
from trigpoint.edge.node import EdgeNode
from trigpoint.edge.sources import frames as frames_module
from trigpoint.edge.sources.frames import Frame, Stamp
from trigpoint.errors import ConfigError, FrameError, InputError
from trigpoint.geometry import CameraModel
from trigpoint.health import Health
from trigpoint.messages import CameraInfo, Picture, Sightings
from trigpoint.node import Node
from trigpoint.target import Target
from trigpoint.topics import CAMERA_INFO, IMAGE, SIGHTINGS, Topic, command_key

BOARD = charuco()
VIEW = placed(BOARD, distance=0.9, tilt_deg=20)
SEEN, EMPTY = picture_of([VIEW]), plain_picture()


class ScriptedFrames:
    """A source whose stamps and pictures the test hands over; an exception among them is raised,
    and the next opening goes on behind it. It says that it skipped one picture for each."""

    script: Iterator[tuple[int, np.ndarray] | Frame | Exception]
    opened = 0
    own_lens: CameraModel | None = None

    def __init__(self, url: str, camera: CameraConfig, *, clock: object) -> None:
        type(self).opened += 1
        self.skipped = 0

    @property
    def intrinsics(self) -> CameraModel | None:
        return self.own_lens

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        for item in self.script:
            if stopping.is_set():
                return
            if isinstance(item, Exception):
                raise item
            self.skipped += 1
            yield item if isinstance(item, Frame) else Frame(item[1], item[0])

    def close(self) -> None:
        pass


class Desk:
    """A site with one camera, an agent that is not started yet, and ears on everything it sends."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._stack, self.folder = stack, folder
        self.broker = MemoryBroker()
        self.bus = stack.enter_context(self.broker.session())

    def listen(self, topic: Topic) -> Subscription:
        return self.bus.subscribe(topic, topic.key("lab", "c1"))

    def start(
        self,
        *pictures: tuple[int, np.ndarray] | Frame | Exception,
        camera: str = "",
        script: Iterator[tuple[int, np.ndarray] | Exception] | None = None,
        target: Target | None = None,
    ) -> Node:
        """Start the agent on these pictures, or on those of a script."""
        ScriptedFrames.script = script or iter(pictures)
        text = f'site = "lab"\ntarget = "t.toml"\n[cameras.c1]\nsource = "script://"\n{camera}\n'
        site = parse_site(text + '[robots.r1]\nport = "loop://"\n', directory=self.folder)
        node = Node(self.bus, site="lab", kind="edge", name="c1")
        agent = EdgeNode(self.bus, node, site, "c1", [target or target_of(BOARD)])
        self._stack.enter_context(node)
        agent.start()
        return node


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    monkeypatch.setattr(frames_module, "source_class", lambda _scheme: ScriptedFrames)
    monkeypatch.setattr(ScriptedFrames, "opened", 0)
    monkeypatch.setattr(ScriptedFrames, "own_lens", None)
    with ExitStack() as stack:
        yield Desk(stack, tmp_path)


def taken(subscription: Subscription) -> list[object]:
    """Everything that came, decoded."""
    messages = []
    while (sample := subscription.take(0.2)) is not None:
        messages.append(decode(sample.encoding.partition(";")[2], sample.payload))
    return messages


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
        camera="rate = 1.0",
    )
    node.wait()
    assert "write columns = 8 and rows = 6" in node.health.held["target file"]


def test_end_of_the_source_ends_the_node(desk: Desk) -> None:
    node = desk.start((1000, EMPTY))
    assert node.stopping.wait(10.0)


def test_lens_of_the_intrinsics_file_is_announced_once(desk: Desk) -> None:
    write_camera_info(desk.folder / "c1.yaml", CAMERA, "c1")
    ScriptedFrames.own_lens = CAMERA.with_parameters(CAMERA.parameters * 1.1)
    ears = desk.listen(CAMERA_INFO)
    desk.start((1000, EMPTY), (2000, EMPTY), camera='intrinsics = "c1.yaml"').wait()
    (info,) = taken(ears)
    assert isinstance(info, CameraInfo)
    assert info.camera == CAMERA


def test_lens_that_the_source_knows_comes_before_the_nominal_one(desk: Desk) -> None:
    ScriptedFrames.own_lens = CAMERA
    ears = desk.listen(CAMERA_INFO)
    desk.start((1000, EMPTY), camera='intrinsics = "estimate"').wait()
    (info,) = taken(ears)
    assert isinstance(info, CameraInfo)
    assert info.camera == CAMERA


@pytest.mark.parametrize("camera", ["", 'intrinsics = "estimate"'])
def test_lens_that_nobody_knows_is_not_announced(
    desk: Desk, caplog: pytest.LogCaptureFixture, camera: str
) -> None:
    ears = desk.listen(CAMERA_INFO)
    desk.start((1000, EMPTY), camera=camera).wait()
    assert taken(ears) == []
    assert ("camera c1 has no intrinsics" in caplog.text) == (not camera)


def test_late_listener_gets_the_lens(desk: Desk) -> None:
    ScriptedFrames.own_lens = CAMERA
    desk.start((1000, EMPTY)).wait()
    assert len(taken(desk.listen(CAMERA_INFO))) == 1


def test_lens_for_another_size_ends_the_node_with_one_line(desk: Desk) -> None:
    node = desk.start((1000, np.zeros((720, 1280), np.uint8)))
    with pytest.raises(
        ConfigError, match=r"pictures are 1280 × 720, but the site file says 640 × 480; write width"
    ):
        node.wait()


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (np.zeros((480, 640), np.uint16), "values are uint16"),
        (np.zeros((480, 640, 4), np.uint8), "has 4 channels"),
        (np.zeros((0, 0), np.uint8), "pictures are 0 × 0"),
        (np.zeros((1, 1), np.uint8), "pictures are 1 × 1"),
    ],
)
def test_pictures_of_a_bad_kind_end_the_node_with_one_line(
    desk: Desk, picture: np.ndarray, said: str
) -> None:
    node = desk.start((1000, picture))
    with pytest.raises(InputError, match=said) as caught:
        node.wait()
    assert "\n" not in str(caught.value)


def test_camera_of_one_pixel_sees_nothing(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    tiny = (1000, np.zeros((1, 1), np.uint8))
    desk.start(tiny, camera="width = 1\nheight = 1").wait()
    (message,) = taken(ears)
    assert isinstance(message, Sightings)
    assert (message.width, message.height, message.faces) == (1, 1, ())


def test_missing_intrinsics_file_is_told_before_anything_starts(desk: Desk) -> None:
    with pytest.raises(InputError, match=r"none\.yaml"):
        desk.start((1000, EMPTY), camera='intrinsics = "none.yaml"')


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
        has_begun.wait(10.0)
        yield 1000, SEEN
        may_end.wait(10.0)

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


def test_frame_that_is_not_newer_is_refused_and_counted(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    node = desk.start((2000, EMPTY), (2000, EMPTY), (1000, EMPTY), (3000, EMPTY))
    node.wait()
    stamps = [message.stamp_ns for message in taken(ears) if isinstance(message, Sightings)]
    assert stamps == [2000, 3000]
    assert node.health.lost("out_of_order") == 2


def test_lost_source_is_told_and_opened_again(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trigpoint.edge.node._FIRST_PAUSE_S", 0.01)
    ears = desk.listen(SIGHTINGS)
    node = desk.start((1000, EMPTY), FrameError("cam: the camera was lost"), (2000, EMPTY))
    node.wait()
    assert len(taken(ears)) == 2
    assert ScriptedFrames.opened == 2
    assert node.health.total("source_lost") == 1
    assert "cam: the camera was lost" in node.health.last_error


def test_frozen_pictures_are_flagged_and_not_looked_at(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    frozen = Frame(SEEN, 2000, Stamp.MONOTONIC, passed_over=20, is_frozen=True)
    node = desk.start(Frame(SEEN, 1000, Stamp.MONOTONIC, passed_over=4), frozen)
    node.wait()
    assert len(taken(ears)) == 1
    assert node.health.lost("frozen") == 1
    assert node.health.total("passed_over") == 24
    assert node.health.report().values["stamps"] == "by the kernel's monotonic clock"


def test_pauses_grow_while_the_source_stays_lost(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.edge.node._FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr("trigpoint.edge.node._LONGEST_PAUSE_S", 0.03)
    said: list[str] = []
    monkeypatch.setattr(Health, "hold", lambda _health, _name, text: said.append(text))
    losses = [FrameError("cam: gone") for _ in range(3)]
    desk.start((1000, EMPTY), *losses, (2000, EMPTY)).wait()
    assert ScriptedFrames.opened == 4
    assert said == ["cam: gone (trying again in 0 s)"] * 3


def test_lost_source_stays_said_until_it_is_back(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("trigpoint.edge.node._FIRST_PAUSE_S", 0.3)
    caplog.set_level(logging.INFO, "trigpoint")
    is_back, may_end = threading.Event(), threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray] | Exception]:
        yield FrameError("cam: gone")
        is_back.wait(10.0)
        yield 1000, EMPTY
        may_end.wait(10.0)

    node = desk.start(script=script())
    assert eventually(lambda: "cam: gone" in node.health.report().message)
    monkeypatch.setattr("trigpoint.health._MEMORY_NS", 0)
    assert "cam: gone" in node.health.report().message
    is_back.set()
    assert eventually(lambda: node.health.report().message == "running")
    may_end.set()
    node.wait()
    assert "gives pictures again, after" in caplog.text


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


def test_state_of_the_source_is_in_the_diagnostics(desk: Desk) -> None:
    has_begun, may_end = threading.Event(), threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        has_begun.wait(10.0)
        yield 1000, EMPTY
        may_end.wait(10.0)

    node = desk.start(script=script())

    def is_said(state: str) -> bool:
        return eventually(lambda: node.health.report().values.get("source") == state)

    assert is_said("opening")
    has_begun.set()
    assert is_said("running")
    may_end.set()
    node.wait()
    assert is_said("ended")
    assert {"detection_ms", "delay_ms", "calibration_views"} <= node.health.report().values.keys()


def test_camera_that_hangs_silences_the_watchdog_and_is_named(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.edge.node._PATIENCE_S", 0.3)
    monkeypatch.setattr("trigpoint.edge.node._PATIENT_PERIODS", 0.0)
    may_end = threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        yield 1000, EMPTY
        may_end.wait(10.0)  # a driver that does not return

    node = desk.start(script=script())
    assert eventually(lambda: node.watchdog.hung == ("edge/c1 sees",))
    (status,) = node.diagnostics().statuses
    assert status.message == "no sign of life of: edge/c1 sees"
    may_end.set()
    node.wait()
    assert eventually(lambda: node.watchdog.hung == ())


def test_calibration_can_be_asked_for(desk: Desk) -> None:
    may_end = threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        yield 1000, SEEN
        may_end.wait(10.0)

    node = desk.start(script=script())
    assert eventually(lambda: node.health.report().values["calibration_views"] == "1")
    (reply,) = desk.bus.query(command_key("lab", "camera/c1/calibrate"))
    may_end.set()
    node.wait()
    assert "1 views of the target were found" in reply.error


def test_skipped_pictures_are_counted_as_lost(desk: Desk) -> None:
    node = desk.start((1000, EMPTY), (2000, EMPTY))
    node.wait()
    assert eventually(lambda: node.health.lost("pictures") == 2)
