"""Reads the site: twenty times a second what is newest on the bus becomes what the pages show."""

import logging
import threading
from collections.abc import Mapping
from itertools import compress

import numpy as np
from msgspec.structs import replace

from trigpoint import CONTRACT, __version__
from trigpoint.base.clock import Clock, SystemClock, to_seconds
from trigpoint.base.errors import BusError, MessageError
from trigpoint.bus.bus import Bus, Latest, Sample, Subscription
from trigpoint.contract import topics
from trigpoint.contract.cdr_layout import pose_estimate_run
from trigpoint.contract.messages import (
    Diagnostics,
    DiagnosticStatus,
    Message,
    OccupancyGrid,
    PoseEstimate,
)
from trigpoint.contract.topics import Topic, alive_key, node_of
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.node.health import Health, Level
from trigpoint.recorder.writing.intake import check_sender, sound_message
from trigpoint.site.config import Site
from trigpoint.tools.site.state import SiteStatus, summarise
from trigpoint.tools.site.status import LISTEN_S, known_of, wanted_of

from .alarms import Alarms
from .entities import Fields
from .feed import Feed
from .floor import Floor, GridPicture, grid_picture
from .history import History
from .pictures import Pictures
from .scene import Scene, are_sound, check_places

PERIOD_S = 0.05
NAME = "board"
_LOOK_S = 1.0
_PARTS = 8
"""Of the reports that wait, so many parts are heard one after the other, twenty a second."""
_HEARD_S = 3.5
"""Nodes send diagnostics once a second; three that are missing are a silence."""
_UNHEARD = ("missing", "silent")
_REPORTS = replace(topics.DIAGNOSTICS, queue=4096)
_POSED = {topics.ROBOT_POSE: "robot", topics.CAMERA_POSE: "camera"}
_MAP = "map"
"""What is given in another frame is not where it would be shown."""
_READ = (
    topics.ROBOT_POSE,
    topics.CAMERA_POSE,
    topics.COVERAGE,
    topics.SUGGESTION,
    topics.COVERAGE_GRID,
)

_ABSURD = MessageError("it lies on no site, or its covariance is none")

_log = logging.getLogger(__name__)


class Reader:
    """Used on one thread, but for `heard` and `picture`. Of a key's messages only the newest is
    decoded."""

    def __init__(
        self,
        site: Site,
        feed: Feed,
        history: History,
        pictures: Pictures,
        *,
        about: Fields,
        clock: Clock | None = None,
    ) -> None:
        """`about`: what the pages should know of the program."""
        self._clock = clock or SystemClock()
        self._site, self._feed, self._history, self._pictures = site, feed, history, pictures
        self._scene = Scene(site.name, site.cameras, site.robots)
        self._floor, self._alarms, self.health = Floor(site), Alarms(), Health(self._clock)
        self._begun_s = round(to_seconds(self._clock.now_ns()))
        self._about = {"name": site.name, "link": "the bus is being opened"} | about
        self._grid: GridPicture | None = None
        self._statuses: dict[str, tuple[float, int, DiagnosticStatus]] = {}
        self._tokens: list[str] = []
        self._missing: list[str] = []
        self._started_s = self._apart_s = self._elapsed_s
        self._looked_s = 0.0
        self._own = self._own_status()
        self.health.gauge("pages", lambda: feed.pages)

    @property
    def _elapsed_s(self) -> float:
        return to_seconds(self._clock.elapsed_ns())

    def picture(self, name: str) -> bytes:
        """The floor «plan» or the «grid» of corrections, PNG; empty without one. Any thread."""
        if name == "plan":
            return self._floor.picture
        return b"" if self._grid is None else self._grid.png

    def begin(self) -> None:
        """Show the site as its file has it, before there is a bus."""
        shown: dict[str, Fields | None] = {**self._scene.changed()}
        self._show(shown | {"site": self._about, "plan": self._floor.fields})

    def run(self, bus: Bus, stopping: threading.Event) -> None:
        latest = [(topic, bus.latest(topic, topic.expression(self._site.name))) for topic in _READ]
        reports = bus.subscribe(_REPORTS, _REPORTS.key(self._site.name))
        for topic, incoming in (*latest, (_REPORTS, reports)):
            self.health.watch(topic.name, incoming)
        asking = threading.Thread(target=self._ask, args=(bus, stopping), name="board alive")
        asking.start()
        due_s = self._apart_s = self._elapsed_s
        try:
            while not stopping.is_set():
                self._read(latest)
                self._hear_some(reports)
                if self._elapsed_s - self._looked_s >= _LOOK_S:
                    self._looked_s = self._elapsed_s
                    self._look(bus)
                due_s = max(due_s + PERIOD_S, self._elapsed_s)
                self._clock.wait(stopping, due_s - self._elapsed_s)
        finally:
            stopping.set()
            asking.join()

    def heard(self) -> list[Diagnostics]:
        """The newest diagnostics of every node, one each name, and the board's own; whoever is
        missing is in error, with stamp 0. Any thread."""
        error, since_s = int(Level.ERROR), self._elapsed_s - _HEARD_S
        heard = {name: (0, DiagnosticStatus(error, name, "", "", {})) for name in self._missing}
        for s, stamp_ns, status in sorted(self._statuses.values(), key=lambda one: one[0]):
            if s > since_s:
                heard[status.name] = (stamp_ns, status)
        heard[NAME] = (self._clock.now_ns(), self._own)
        return [Diagnostics(stamp_ns, (status,)) for stamp_ns, status in heard.values()]

    def _read(self, latest: list[tuple[Topic, Latest]]) -> None:
        for topic, incoming in latest:
            samples = incoming.take()
            if topic in _POSED:
                self._take_poses(topic, samples)
            else:
                for sample in samples:
                    self._take(topic, sample)
        self._show(self._scene.changed())

    def _hear_some(self, reports: Subscription) -> None:
        """A part of the reports that wait: all of a second's at once would hold up what moves."""
        for _ in range(-(-reports.depth // _PARTS)):
            if (sample := reports.take(0.0)) is not None:
                self._hear(sample)

    def _look(self, bus: Bus) -> None:
        """What is seen once a second, after what moves has been shown."""
        self._scene.age(self._clock.now_ns())
        self._pictures.end_idle()
        self._show(self._overview(bus))

    def _take(self, topic: Topic, sample: Sample) -> None:
        message = self._sound(topic, sample)
        if message is None:
            return
        try:
            if isinstance(message, OccupancyGrid):
                check_places(message.origin.translation)
                self._grid = grid_picture(message.cell_m, message.origin, message.values)
            else:
                self._scene.take(topic, node_of(sample.key), message, sample.received_ns)
        except MessageError as reason:
            self.health.reject(sample, reason)

    def _take_poses(self, topic: Topic, samples: list[Sample]) -> None:
        """Take all at once; they are decoded one by one only if one of them is not sound."""
        known = [sample for sample in samples if self._is_known(topic, sample)]
        if not known:
            return
        run = pose_estimate_run([sample.payload for sample in known], _MAP)
        if run is not None:
            stamps_ns, poses, covariances = run
            self._place(topic, known, stamps_ns, poses, covariances)
            return
        decoded = [(sample, self._sound(topic, sample)) for sample in known]
        sound = [(sample, one) for sample, one in decoded if isinstance(one, PoseEstimate)]
        if sound:
            self._place(
                topic,
                [sample for sample, _ in sound],
                np.array([one.stamp_ns for _, one in sound]),
                Pose.stack([one.pose for _, one in sound]),
                np.array([one.covariance for _, one in sound]),
            )

    def _is_known(self, topic: Topic, sample: Sample) -> bool:
        try:
            check_sender(topic, sample, self._site)
        except MessageError as reason:
            self.health.reject(sample, reason)
            return False
        return True

    def _place(
        self,
        topic: Topic,
        samples: list[Sample],
        stamps_ns: np.ndarray,
        poses: Pose,
        covariances: Array,
    ) -> None:
        chosen = are_sound(poses, covariances)
        for sample in compress(samples, ~chosen):
            self.health.reject(sample, _ABSURD)
        if not chosen.any():
            return
        samples, stamps_ns = [*compress(samples, chosen)], stamps_ns[chosen]
        poses, covariances = poses[chosen], covariances[chosen]
        entities = [f"{_POSED[topic]}/{node_of(sample.key)}" for sample in samples]
        received_ns = [sample.received_ns for sample in samples]
        self._scene.take_poses(entities, poses, covariances, received_ns)
        self._floor.take(entities, poses, covariances, stamps_ns.tolist())

    def _sound(self, topic: Topic, sample: Sample) -> Message | None:
        try:
            message = sound_message(topic, sample, self._site)
            if (frame := getattr(message, "frame_id", _MAP)) != _MAP:
                raise MessageError(f"it is given in frame «{frame}», not in «{_MAP}»")
            return message
        except MessageError as reason:
            self.health.reject(sample, reason)
            return None

    def _hear(self, sample: Sample) -> None:
        message = self._sound(topics.DIAGNOSTICS, sample)
        if isinstance(message, Diagnostics):
            for status in message.statuses:
                unique = f"{status.name} {status.values.get('node', '')}"
                self._statuses[unique] = (self._elapsed_s, message.stamp_ns, status)
                self._scene.report(status.name, status.values, sample.received_ns)

    def _overview(self, bus: Bus) -> dict[str, Fields | None]:
        """The site in words; of its nodes only where these had time to speak."""
        self._own = self._own_status()
        unreached = ", ".join(bus.unreached)
        link = f"nobody answers at {unreached}; trying again" if unreached else ""
        about: Fields = self._about | {"peers": len(bus.peers), "link": link}
        about["begin"] = round(self._history.begin_s or 0)
        about["started"] = self._begun_s
        shown: dict[str, Fields | None] = {"site": about, "plan": self._floor.fields}
        shown["grid"] = None if self._grid is None else self._grid.fields
        now_s = self._elapsed_s
        if link:
            self._apart_s, self._missing = now_s, []
        if now_s - self._apart_s > LISTEN_S:
            status = self._status(len(bus.peers))
            self._missing = [node.name for node in status.nodes if node.state in _UNHEARD]
            shown |= self._alarms.look(status, to_seconds(self._clock.now_ns()))
        return shown

    def _status(self, peers: int) -> SiteStatus:
        since_s = self._elapsed_s - _HEARD_S
        self._statuses = {n: one for n, one in self._statuses.items() if one[0] > since_s}
        return summarise(
            self._site.name,
            peers=peers,
            tokens=[*self._tokens, f"{self._site.name}/alive/{NAME}"],
            statuses=[*(one for _, _, one in self._statuses.values()), self._own],
            wanted=wanted_of(self._site),
            known=known_of(self._site),
            expect=self._site.expect,
        )

    def _show(self, entities: Mapping[str, Fields | None]) -> None:
        now_s = to_seconds(self._clock.now_ns())
        change = self._feed.update(entities, now_s)
        self._history.keep(change, self._feed.whole(), now_s)

    def _own_status(self) -> DiagnosticStatus:
        if (more := self._feed.dropped - self.health.lost("slow pages")) > 0:
            self.health.lose("slow pages", more)
        report = self.health.report()
        values = {
            "version": __version__,
            "contract": str(CONTRACT),
            "node": NAME,
            "uptime": f"{self._elapsed_s - self._started_s:.1f}",
        }
        level = int(report.level)
        return DiagnosticStatus(level, NAME, report.message, "", values | report.values)

    def _ask(self, bus: Bus, stopping: threading.Event) -> None:
        """Who is alive, once a second: the answer may take as long as a lost session's link."""
        while not stopping.wait(_LOOK_S):
            try:
                self._tokens = bus.alive(alive_key(self._site.name, "*", "*"), timeout_s=_LOOK_S)
            except BusError as reason:
                _log.debug("%s", reason)
