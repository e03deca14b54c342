"""One camera's agent as a node: source -> tracker -> bus."""

import logging
import threading
from collections.abc import Callable, Sequence

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import Clock, SteadyClock, to_seconds
from trigpoint.base.errors import FrameError
from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract.cdr import encode, warm_up
from trigpoint.contract.clock_doubt import REFUSED_FROM
from trigpoint.contract.messages import CameraInfo, FaceSighting, Sightings
from trigpoint.contract.nudge import NUDGED, NUDGES, Nudge
from trigpoint.contract.topics import CAMERA_INFO, IMAGE, SIGHTINGS, Topic, command_key
from trigpoint.geometry import CameraModel
from trigpoint.node.clock_watch import ClockWatch
from trigpoint.node.node import Node
from trigpoint.site.config import Site
from trigpoint.site.target import Target, load_target

from .background.watch import BackgroundWatch
from .image.picture import depth_words, eight_bits
from .lens.calibration_service import CalibrationService
from .lens.intrinsics import calibrated_lens, check_size, known_lens
from .picture_sender import PictureSender
from .sources.frames import Frame, FrameSource, Unreadable, open_source
from .target_watch import TargetWatch
from .tracker import TargetTracker

_log = logging.getLogger(__name__)

KIND = "edge"
_FIRST_PAUSE_S = 1.0
_LONGEST_PAUSE_S = 30.0
_SOUND_S = 10.0
"""After a source has run for this long, retries start with the shortest pause again."""
_UNREADABLE_S = 2.0
_PATIENCE_S = 20.0
"""How long the camera's thread may take for a picture, or to open, before it counts as hung."""
_PATIENT_PERIODS = 5.0


class EdgeNode:
    """Runs inside `node`'s life: `start` declares and starts, the node's end stops.

    At the end of a file the node stops; a lost source is reopened, with pauses that grow to half a
    minute.
    """

    def __init__(
        self,
        bus: Bus,
        node: Node,
        site: Site,
        camera: str,
        targets: Sequence[Target],
        *,
        clock: Clock | None = None,
    ) -> None:
        """`targets`: one per robot. Raises InputError if the intrinsics file is wrong."""
        self._bus, self._node, self._site, self._camera = bus, node, site, camera
        self._clock = clock or node.clock
        self._config = site.camera(camera)
        self._tracker = TargetTracker(targets, budget_s=1 / self._config.rate, clock=self._clock)
        self._calibrated = calibrated_lens(site, camera)
        self._calibration = CalibrationService(
            camera, targets, line_delay_s=self._config.line_delay
        )
        self._lens: CameraModel | None = None
        self._is_announced = False
        self._last_ns = -1
        self._followed = 0
        self._lost_ns: int | None = None
        self._spoilt_ns: int | None = None
        self._watch = TargetWatch(camera, self._clock)
        self._background = BackgroundWatch() if self._config.notice_nudges else None
        self._pause_s = _FIRST_PAUSE_S
        self._newest_ns = self._clock.elapsed_ns()
        self._is_deep = False

    def start(self) -> None:
        """Declare the camera's publishers and commands, and start its thread."""
        warm_up()
        self._sightings = self._publisher(SIGHTINGS)
        self._camera_info = self._publisher(CAMERA_INFO)
        self._pictures = PictureSender(self._camera, self._config, self._publisher(IMAGE))
        self._serve("snapshot", self._pictures.snapshot)
        self._serve("calibrate", self._calibration.answer)
        self._node.health.count(NUDGES, 0)
        self._node.health.gauge("picture_age_s", self._picture_age_s)
        self._node.health.gauge("calibration_views", lambda: self._calibration.kept)
        self._pulse = self._node.watchdog.pulse(f"{self._node.label} sees", within_s=_PATIENCE_S)
        self._node.thread("sees", self._run)
        watch = ClockWatch(
            self._bus,
            self._node,
            self._site,
            self._clock.now_ns,
            self._site.bearable_clock_offset_s(self._camera),
            f"from {REFUSED_FROM:g} times that on, what camera {self._camera} sees is not used "
            "beside clocks that are right",
        )
        self._node.work("clock", watch.run)

    def _picture_age_s(self) -> float:
        """How long no new picture has come, or since the start."""
        return to_seconds(self._clock.elapsed_ns() - self._newest_ns)

    def _serve(self, command: str, answer: Callable[[bytes], bytes]) -> None:
        key = command_key(self._site.name, f"camera/{self._camera}/{command}")
        self._node.keep(self._bus.serve(key, answer))

    def _publisher(self, topic: Topic) -> Publisher:
        return self._node.keep(self._bus.publisher(topic, self._key(topic)))

    def _run(self) -> None:
        try:
            self._see(self._node.stopping)
        finally:
            self._node.watchdog.forget(self._pulse)
            health = self._node.health
            lost = sum(health.lost(n) for n in ("pictures", "unreadable", "out_of_order", "frozen"))
            self._watch.sum_up(lost=lost)

    def _see(self, stopping: threading.Event) -> None:
        while not stopping.is_set():
            began_ns = self._clock.elapsed_ns()
            try:
                self._play(stopping)
            except FrameError as reason:
                if to_seconds(self._clock.elapsed_ns() - began_ns) > _SOUND_S:
                    self._pause_s = _FIRST_PAUSE_S
                self._wait_for_source(reason, stopping)
            else:
                self._say("ended")
                if not stopping.is_set():
                    _log.info("camera %s: its source has come to its end", self._camera)
                self._node.stop()

    def _wait_for_source(self, reason: FrameError, stopping: threading.Event) -> None:
        health = self._node.health
        health.count("source_lost")
        self._say("lost")
        self._lost_ns = self._lost_ns or self._clock.elapsed_ns()
        health.hold("source", f"{reason} (trying again in {self._pause_s:.0f} s)")
        self._pulse.beat(self._pause_s + _PATIENCE_S)
        self._clock.wait(stopping, self._pause_s)
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)

    def _run_again(self) -> None:
        """Note that pictures are arriving again."""
        self._say("running")
        self._node.health.release("source")
        if self._lost_ns is not None:
            away_s = to_seconds(self._clock.elapsed_ns() - self._lost_ns)
            _log.info("camera %s gives pictures again, after %.0f s", self._camera, away_s)
            self._lost_ns = None

    def _play(self, stopping: threading.Event) -> None:
        """Handle every picture until the source ends; raises FrameError if the source is lost."""
        self._say("opening")
        # A source may be slow to open, and then to give its first picture or to fail.
        self._pulse.beat(_PATIENCE_S)
        config = self._config
        source = open_source(
            config.source, config, clock=self._clock, directory=self._site.directory
        )
        try:
            skipped = 0
            for frame in source.frames(stopping):
                self._pulse.beat(_PATIENCE_S + _PATIENT_PERIODS / config.rate)
                if frame is None:
                    self._say("waiting")
                    self._node.health.release("source")
                elif isinstance(frame, Unreadable):
                    self._miss(frame.reason)
                else:
                    self._handle(frame, source)
                self._node.health.lose("pictures", source.skipped - skipped)
                skipped = source.skipped
        finally:
            source.close()

    def _miss(self, reason: str) -> None:
        """Count a picture that cannot be read; where no other has come for long, that is an
        error."""
        self._node.health.lose("unreadable")
        now_ns = self._clock.elapsed_ns()
        if self._spoilt_ns is None:
            self._spoilt_ns = now_ns
        if (age_s := to_seconds(now_ns - self._spoilt_ns)) > _UNREADABLE_S:
            self._say("unreadable")
            text = f"camera {self._camera}: no picture that can be read for {age_s:.0f} s; {reason}"
            self._node.health.hold("source", text)

    def _handle(self, frame: Frame, source: FrameSource) -> None:
        health = self._node.health
        self._spoilt_ns = None
        health.count("pictures")
        health.count("passed_over", frame.passed_over)
        health.describe("stamps", frame.stamp.value)
        if frame.is_frozen:
            health.lose("frozen")
            self._say("frozen")
            health.hold("source", f"camera {self._camera} gives the same picture again and again")
            return
        self._run_again()
        self._follow_clock()
        if frame.captured_ns <= self._last_ns:
            health.lose("out_of_order")
            return
        self._last_ns = frame.captured_ns
        self._newest_ns = self._clock.elapsed_ns()
        frame = replace(frame, picture=self._scaled(frame.picture))
        self._pictures.keep(frame)
        self._announce(frame, source)
        self._publish(frame)
        if self._pictures.offer(frame):
            health.count(f"sent {self._key(IMAGE)}")
            if self._lens is not None:  # with every picture, as ROS viewers expect
                self._say_lens(frame, self._lens)

    def _scaled(self, picture: np.ndarray) -> np.ndarray:
        """The picture in 8 bits; that it was deeper is shown, and logged once."""
        if words := depth_words(picture):
            if not self._is_deep:
                _log.info("camera %s: its pictures have %s; scaled by that", self._camera, words)
            self._is_deep = True
            self._node.health.describe("depth", words)
        return eight_bits(picture)

    def _follow_clock(self) -> None:
        """Accept earlier stamps again once they follow a clock that was set back."""
        if isinstance(self._clock, SteadyClock) and self._clock.followed != self._followed:
            self._followed = self._clock.followed
            self._last_ns = -1

    def _announce(self, frame: Frame, source: FrameSource) -> None:
        """Send the lens with the first picture; raises ConfigError if it does not fit a picture."""
        if not self._is_announced:
            self._is_announced = True
            self._lens = known_lens(self._site, self._camera, self._calibrated, source.intrinsics)
            if self._lens is not None:
                self._say_lens(frame, self._lens)
        check_size(self._camera, self._config, self._lens, frame.picture.shape)

    def _say_lens(self, frame: Frame, lens: CameraModel) -> None:
        info = CameraInfo(frame.captured_ns, self._frame_id, lens)
        self._camera_info.put(encode(info))
        self._node.health.count(f"sent {self._key(CAMERA_INFO)}")

    def _publish(self, frame: Frame) -> None:
        """Find the faces and send them, even if there are none."""
        began_ns, given_up = self._clock.elapsed_ns(), self._tracker.given_up
        faces = self._tracker.detect(frame.picture, frame.captured_ns)
        self._node.health.observe("detection", to_seconds(self._clock.elapsed_ns() - began_ns))
        height, width = frame.picture.shape[:2]
        message = Sightings(frame.captured_ns, self._frame_id, width, height, faces)
        self._sightings.put(encode(message))
        delay_s = to_seconds(self._clock.now_ns() - frame.captured_ns)
        self._node.health.observe("sighting_delay", delay_s)
        self._node.health.count(f"sent {self._key(SIGHTINGS)}")
        self._node.health.count("faces", len(faces))
        self._watch.saw(len(faces))
        self._node.health.lose("given_up", self._tracker.given_up - given_up)
        self._calibration.offer(faces, (width, height), frame.captured_ns)
        self._name_misdescribed()
        self._look_behind(frame, faces)

    def _look_behind(self, frame: Frame, faces: Sequence[FaceSighting]) -> None:
        """Hold the picture against the camera's background, where that is wanted; report that the
        camera was moved."""
        if self._background is None:
            return
        outlines = [face.pixels for face in faces]
        is_nudged = self._background.look(frame.picture, frame.captured_ns, outlines)
        self._node.health.describe("background", self._background.view.value)
        nudge = self._background.nudge
        if not is_nudged or nudge is None:
            return
        told = Nudge(self._camera, nudge.until_ns, nudge.since_ns)
        self._node.health.describe(NUDGED, told.value)
        self._node.health.count(NUDGES)
        words = f"camera {self._camera} {nudge.words(self._config.horizontal_fov)}"
        self._node.health.fail(f"{words}; it makes no corrections until it is located again")

    def _name_misdescribed(self) -> None:
        """Report boards that the target file describes wrongly, while the pictures say so."""
        if lines := self._tracker.misdescribed:
            self._node.health.hold("target file", "; ".join(lines))
        else:
            self._node.health.release("target file")

    def _say(self, state: str) -> None:
        self._node.health.describe("source", state)

    def _key(self, topic: Topic) -> str:
        return topic.key(self._site.name, self._camera)

    @property
    def _frame_id(self) -> str:
        return f"{self._camera}/optical"


def load_targets(site: Site) -> list[Target]:
    """Every robot's target, one per robot, or the site's own; raises TargetError."""
    return [load_target(site.path(name)) for name in site.target_names]
