"""The live site in rerun: the bus's threads fill a bounded queue, one thread draws."""

import threading
from collections import deque

import rerun as rr

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
_SETTLED = 8
"""Periods after which what is kept for late joiners has come, so that the eye has its place."""
_GROWTH = 1.25


class LiveView:
    """Draws one site into a recording. The oldest samples are dropped where drawing is too slow."""

    def __init__(self, site: Site, targets: dict[str, Target], stream: rr.RecordingStream) -> None:
        self._site, self._stream = site, stream
        self._columns = Columns(stream)
        self._scene = Scene(site, targets, self._columns, plan=load_plan(site))
        self._queue: deque[tuple[Topic, str, Message, int]] = deque()
        self._lock = threading.Lock()
        self._shown_size = 0.0

    def start(self, bus: Bus, node: Node) -> None:
        """Start the node's threads; they draw until the node stops."""
        self._node = node
        node.health.gauge("drawing.depth", lambda: len(self._queue))
        node.thread("draw", self._draw)
        Intake(bus, node, self._site, list(TOPICS), self._put)

    def _put(self, topic: Topic, sample: Sample, message: Message) -> None:
        with self._lock:
            if len(self._queue) >= QUEUE:
                self._queue.popleft()
                self._node.health.lose("drawing")
            self._queue.append((topic, node_of(sample.key), message, sample.received_ns))

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
            waiting, self._queue = self._queue, deque()
        for topic, name, message, received_ns in waiting:
            self._scene.add(topic, name, message, received_ns)
        self._node.health.count("drawn", len(waiting))
        self._columns.flush()

    def _look(self) -> None:
        """Send the blueprint where the site has outgrown the view; else leave the eye alone."""
        size = self._scene.size_m
        if self._shown_size and size < _GROWTH * self._shown_size:
            return
        self._shown_size = max(size, 1.0)
        self._stream.send_blueprint(blueprint(self._site, self._scene.extent))
