"""The live site in rerun: the bus's threads fill a bounded queue; one draws as fast as rerun takes
it."""

import logging
import threading
from collections import Counter
from contextlib import suppress

import rerun as rr
from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.bus.bus import Bus, Sample
from trigpoint.contract.messages import Message
from trigpoint.contract.topics import TOPICS, Topic, node_of
from trigpoint.map.building import load_plan
from trigpoint.node.node import Node
from trigpoint.recorder.writing.intake import Intake
from trigpoint.site.config import Site
from trigpoint.site.target import Target

from .blueprint import blueprint
from .columns import Columns
from .scene import Scene

KIND = "view"
QUEUE = 4096
PERIOD_S = 0.2
_MOST_BEHIND_NS = to_ns(2.0)
_TAKING_S = 0.3
"""How long one look lasts whether rerun has taken what was drawn."""
_SETTLED = 8
"""Periods after which what is kept for late joiners has come, so that the eye has its place."""
_GROWTH = 1.25


_log = logging.getLogger(__name__)


class _Waiting(Struct, frozen=True):
    """A message that is to be drawn."""

    topic: Topic
    key: str
    message: Message
    received_ns: int


class LiveView:
    """Draws one site into a recording. Where that, or rerun, falls two seconds behind, only the
    newest message of each key is drawn of what waits."""

    def __init__(self, site: Site, targets: dict[str, Target], stream: rr.RecordingStream) -> None:
        self._site, self._stream = site, stream
        self._columns = Columns(stream)
        self._scene = Scene(site, targets, self._columns, plan=load_plan(site))
        self._queue: list[_Waiting] = []
        self._since_ns = 0
        self._dropped: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._shown_size = 0.0
        self._is_said = False

    def start(self, bus: Bus, node: Node) -> None:
        """Start the node's threads; they draw until the node stops."""
        self._node = node
        node.health.gauge("drawing.depth", lambda: len(self._queue))
        node.thread("draw", self._draw)
        Intake(bus, node, self._site, list(TOPICS), self._put)

    def _put(self, topic: Topic, sample: Sample, message: Message) -> None:
        one = _Waiting(topic, sample.key, message, sample.received_ns)
        with self._lock:
            if not self._queue:
                self._since_ns = one.received_ns
            behind_ns = one.received_ns - self._since_ns
            if len(self._queue) >= QUEUE or behind_ns > _MOST_BEHIND_NS:
                self._drop_to_newest()
                self._since_ns = one.received_ns
            self._queue.append(one)

    def _drop_to_newest(self) -> None:
        newest = list({one.key: one for one in self._queue}.values())
        dropped = Counter(one.topic.name for one in self._queue)
        dropped.subtract(one.topic.name for one in newest)
        self._node.health.lose("drawing", dropped.total())
        self._dropped += dropped
        self._queue = newest

    def _draw(self) -> None:
        self._scene.announce()
        self._look()
        periods = 0
        while not self._node.stopping.wait(PERIOD_S):
            self._draw_waiting()
            periods += 1
            if periods % _SETTLED == 0:
                self._look()
        self._draw_waiting()
        self._scene.finish()
        self._columns.flush()

    def _draw_waiting(self) -> None:
        with self._lock:
            waiting, self._queue = self._queue, []
        for one in waiting:
            self._scene.add(one.topic, node_of(one.key), one.message, one.received_ns)
        self._node.health.count("drawn", len(waiting))
        self._columns.flush()
        self._wait_for_rerun()
        self._say_dropped()

    def _wait_for_rerun(self) -> None:
        """Until it has taken what was drawn; it keeps whatever it is given, and shows it late."""
        while not self._node.stopping.is_set():
            with suppress(RuntimeError):  # not yet
                self._stream.flush(timeout_sec=_TAKING_S)
                return

    def _say_dropped(self) -> None:
        """Log the first time that something was dropped; the diagnostics count on."""
        with self._lock:
            dropped = +self._dropped
        if dropped and not self._is_said:
            self._is_said = True
            what = ", ".join(f"{count} {name}" for name, count in dropped.most_common())
            _log.warning("drawing fell behind and went on with the newest; not drawn: %s", what)

    def _look(self) -> None:
        """Send the blueprint where the site has outgrown the view; else leave the eye alone."""
        size = self._scene.size_m
        if self._shown_size and size < _GROWTH * self._shown_size:
            return
        self._shown_size = max(size, 1.0)
        self._stream.send_blueprint(blueprint(self._site, self._scene.extent))
