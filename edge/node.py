"""The agent of one camera as a node: source -> detector -> bus."""

import threading

from trigpoint.bus import Bus
from trigpoint.cdr import encode, warm_up
from trigpoint.clock import Clock, SystemClock, to_seconds
from trigpoint.config import Site
from trigpoint.errors import FrameError
from trigpoint.geometry import CameraModel
from trigpoint.messages import CameraInfo, Sightings
from trigpoint.node import Node
from trigpoint.target import Target, load_target
from trigpoint.topics import CAMERA_INFO, IMAGE, SIGHTINGS, Topic, command_key

from .detector import TargetDetector
from .frames import Frame, FrameSource, open_source
from .intrinsics import announced_lens, calibrated_lens, check_size
from .picture_sender import PictureSender

KIND = "edge"
_FIRST_PAUSE_S = 1.0
_LONGEST_PAUSE_S = 30.0


class EdgeNode:
    """Runs inside `node`'s life: `start` declares and starts, the node's end stops.

    At the end of a file the node stops; a source that is lost is opened again, after pauses that
    grow to half a minute.
    """

    def __init__(
        self,
        bus: Bus,
        node: Node,
        site: Site,
        camera: str,
        detector: TargetDetector,
        *,
        clock: Clock | None = None,
    ) -> None:
        """Raises InputError where the intrinsics file is wrong."""
        self._bus, self._node, self._site, self._camera = bus, node, site, camera
        self._detector = detector
        self._clock = clock or SystemClock()
        self._config = site.camera(camera)
        self._calibrated = calibrated_lens(site, camera)
        self._lens: CameraModel | None = None
        self._last_ns = -1
        self._pause_s = _FIRST_PAUSE_S
        self._detection_ms = self._delay_ms = 0.0

    def start(self) -> None:
        """Declare what the camera sends and serves, and start its thread."""
        warm_up()
        site, camera = self._site.name, self._camera
        self._sightings = self._bus.publisher(SIGHTINGS, self._key(SIGHTINGS))
        self._camera_info = self._bus.publisher(CAMERA_INFO, self._key(CAMERA_INFO))
        images = self._bus.publisher(IMAGE, self._key(IMAGE))
        self._pictures = PictureSender(camera, self._config, images)
        self._bus.serve(command_key(site, f"camera/{camera}/snapshot"), self._pictures.snapshot)
        self._node.health.gauge("detection_ms", lambda: self._detection_ms)
        self._node.health.gauge("delay_ms", lambda: self._delay_ms)
        self._node.thread("sees", self._run)

    def _run(self) -> None:
        stopping, health = self._node.stopping, self._node.health
        while not stopping.is_set():
            try:
                self._play(stopping)
            except FrameError as reason:
                health.count("source_lost")
                health.fail(f"{reason} (trying again in {self._pause_s:.0f} s)")
                self._clock.wait(stopping, self._pause_s)
                self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
            else:
                self._node.stop()

    def _play(self, stopping: threading.Event) -> None:
        """Handle every picture until the source's end; raises FrameError where it is lost."""
        source = open_source(
            self._config.source,
            self._config,
            clock=self._clock,
            directory=self._site.directory,
        )
        try:
            skipped = 0
            for frame in source.frames(stopping):
                self._handle(frame, source)
                self._node.health.lose("pictures", source.skipped - skipped)
                skipped = source.skipped
        finally:
            source.close()

    def _handle(self, frame: Frame, source: FrameSource) -> None:
        health = self._node.health
        health.count("pictures")
        self._pause_s = _FIRST_PAUSE_S
        if frame.captured_ns <= self._last_ns:
            health.lose("out_of_order")
            return
        self._last_ns = frame.captured_ns
        self._announce(frame, source)
        self._publish(frame)
        if self._pictures.offer(frame):
            health.count(f"sent {self._key(IMAGE)}")

    def _announce(self, frame: Frame, source: FrameSource) -> None:
        """Send the lens with the first picture; raises ConfigError where it does not fit one."""
        known = self._lens
        lens = known or announced_lens(
            self._site, self._camera, self._calibrated, source.intrinsics
        )
        check_size(self._camera, lens, frame.picture.shape)
        if known is None:
            self._lens = lens
            self._camera_info.put(encode(CameraInfo(frame.captured_ns, self._frame_id, lens)))
            self._node.health.count(f"sent {self._key(CAMERA_INFO)}")

    def _publish(self, frame: Frame) -> None:
        """Find the faces and send them, also where there are none."""
        began_ns = self._clock.elapsed_ns()
        faces = self._detector.detect(frame.picture)
        self._detection_ms = to_seconds(self._clock.elapsed_ns() - began_ns) * 1e3
        height, width = frame.picture.shape[:2]
        message = Sightings(frame.captured_ns, self._frame_id, width, height, faces)
        self._sightings.put(encode(message))
        self._delay_ms = to_seconds(self._clock.now_ns() - frame.captured_ns) * 1e3
        self._node.health.count(f"sent {self._key(SIGHTINGS)}")
        self._node.health.count("faces", len(faces))

    def _key(self, topic: Topic) -> str:
        return topic.key(self._site.name, self._camera)

    @property
    def _frame_id(self) -> str:
        return f"{self._camera}/optical"


def load_targets(site: Site) -> list[Target]:
    """Every robot's target, one a robot; raises TargetError."""
    return [load_target(site.path(site.target_name(robot))) for robot in site.robots]
