"""The live estimator on the bus: messages to the pipeline, its outputs to their keys."""

import json
import logging
import threading
from pathlib import Path

from trigpoint import cdr, topics
from trigpoint.bus import Bus, Publisher, Sample, Subscription
from trigpoint.clock import Clock, to_seconds
from trigpoint.errors import MessageError, OperationError
from trigpoint.network import encode_network
from trigpoint.node import Node
from trigpoint.topics import Topic, command_key

from .checkpoint import Checkpoint, read_checkpoint
from .guidance_world import GuidanceWorld
from .guide import Guide
from .pipeline import Inputs, Output, Pipeline

KIND = "fusion"
NAME = "fusion"

# The robot's next odometry message ends the wait; without one the others are looked at this often.
_TURN_S = 0.02
_MOST_AT_ONCE = 512
# The longest turn so far was a solution; the last one takes several times as long.
_LAST_SOLUTION_S = 0.5

_log = logging.getLogger(__name__)


class FusionNode:
    """One site's estimator. The pipeline is used under a lock, but for its counters."""

    def __init__(self, bus: Bus, node: Node, inputs: Inputs, out: Path, clock: Clock) -> None:
        self._bus, self._node, self._inputs, self._clock = bus, node, inputs, clock
        self._site, self._out = inputs.site, out
        self._lock = threading.Lock()
        self._pipeline = Pipeline(inputs, is_live=False)
        self._announced: dict[str, bytes] = {}
        self._reported: dict[str, int] = {}
        self._located_count = 0
        self._longest_s = 0.0
        self._path = out / "checkpoint.bin"
        self._resume()
        self._checkpoint = Checkpoint(self._path, clock)
        self._publishers: dict[str, Publisher] = {}
        self._subscriptions: list[tuple[Topic, Subscription]] = []
        self._problem = ""

    def start(self) -> None:
        """Subscribe, serve the commands, and start the working thread."""
        name = self._site.name
        for topic in (topics.ODOMETRY, topics.CAMERA_INFO, topics.SIGHTINGS):
            subscription = self._bus.subscribe(topic, topic.expression(name))
            self._subscriptions.append((topic, subscription))
            self._node.health.watch(topic.name, subscription)
        self._node.health.gauge("waiting", lambda: self._pipeline.waiting)
        self._node.health.gauge("cameras_located", lambda: self._located_count)
        for path, answer in (
            ("fusion/network", self._answer_network),
            ("fusion/map", self._answer_map),
            ("fusion/reset", self._answer_reset),
            ("clock", self._answer_clock),
        ):
            self._bus.serve(command_key(name, path), answer)
        self._node.thread("estimate", self._run)
        self._node.thread("guide", Guide(self._bus, self._node, name, self._guidance_world).run)

    def finish(self) -> None:
        """Write what is known, worked out to the end where that is quick enough for a stop.

        Called after the working thread ended.
        """
        with self._lock:
            self._checkpoint.close()
            # What is known now is kept first: whoever stops us may not wait for the last solution.
            self._pipeline.results().save(self._out)
            if self._longest_s < _LAST_SOLUTION_S:
                self._pipeline.finish()
                self._pipeline.results().save(self._out)
            else:
                _log.info("the last solution is left to `trigpoint calibrate`: it would take long")
        _log.info("the network is in %s", self._out / "network.json")

    # -- the working thread -----------------------------------------------------------------------

    def _run(self) -> None:
        while not self._node.stopping.is_set():
            first = self._subscriptions[0][1].take(_TURN_S)
            with self._lock:
                if first is not None:
                    self._take(topics.ODOMETRY, first)
                self._take_all()
                began_ns = self._clock.elapsed_ns()
                outputs = self._pipeline.advance(self._clock.now_ns())
                took_s = to_seconds(self._clock.elapsed_ns() - began_ns)
                self._longest_s = max(self._longest_s, took_s)
                self._checkpoint.flush()
                self._located_count = self._pipeline.located_count
            # A robot waits for its correction, nobody for the rest.
            for output in sorted(outputs, key=lambda o: o.topic is not topics.CORRECTION):
                self._publish(output)
            self._report()

    def _take_all(self) -> None:
        for topic, subscription in self._subscriptions:
            for _ in range(_MOST_AT_ONCE):
                sample = subscription.take(0.0)
                if sample is None:
                    break
                self._take(topic, sample)

    def _take(self, topic: Topic, sample: Sample) -> None:
        try:
            if sample.encoding != topic.encoding:
                raise MessageError(f"its encoding is «{sample.encoding}», not «{topic.encoding}»")
            message = cdr.decode(topic.type_name, sample.payload)
        except MessageError as reason:
            self._node.health.reject(sample, reason)
            return
        self._node.health.count(f"received {sample.key}")
        if topic is topics.CAMERA_INFO:
            self._announced[sample.key] = sample.payload
        self._checkpoint.write(sample.key, sample.payload)
        self._pipeline.push(topics.node_of(sample.key), message)

    def _publish(self, output: Output) -> None:
        key = output.topic.key(self._site.name, output.node)
        if key not in self._publishers:
            self._publishers[key] = self._bus.publisher(output.topic, key)
        self._publishers[key].put(cdr.encode(output.message), attachment=output.attachment)
        self._node.health.count(f"sent {key}")

    def _guidance_world(self) -> GuidanceWorld | None:
        with self._lock:
            return self._pipeline.guidance_world()

    def _report(self) -> None:
        """Bring what the pipeline left out into the diagnostics."""
        for reason, count in self._pipeline.left_out.items():
            more = count - self._reported.get(reason, 0)
            if more > 0:
                self._node.health.count(f"left_out.{reason}", more)
            self._reported[reason] = count
        if self._pipeline.last_problem != self._problem:
            self._problem = self._pipeline.last_problem
            self._node.health.fail(self._problem)

    # -- the checkpoint ---------------------------------------------------------------------------

    def _resume(self) -> None:
        """Take up the map that a killed fusion left."""
        count = 0
        if self._path.exists():
            _log.info("reading %s; nothing is estimated until that is done", self._path)
        for key, payload in read_checkpoint(self._path):
            topic = topics.topic_of(key)
            if topic is None or not key.startswith(f"{self._site.name}/"):
                raise OperationError(
                    f"{self._path}: a checkpoint of another site ({key}); give another --out"
                )
            try:
                message = cdr.decode(topic.type_name, payload)
            except MessageError as reason:
                _log.error("%s: a message on %s is left out: %s", self._path, key, reason)
                continue
            self._pipeline.push(topics.node_of(key), message)
            count += 1
            if topic is topics.CAMERA_INFO:
                self._announced[key] = payload
            if topic is topics.ODOMETRY:
                self._pipeline.advance()
        self._pipeline.advance()
        if not count:
            self._pipeline = Pipeline(self._inputs)
        else:
            self._pipeline.resumed()
            _log.info(
                "map %s resumed from %s (%d messages); the command %s starts a new one",
                self._pipeline.map_id,
                self._path,
                count,
                command_key(self._site.name, "fusion/reset"),
            )

    # -- commands, on the bus's threads -----------------------------------------------------------

    def _answer_network(self, _request: bytes) -> bytes:
        with self._lock:
            results = self._pipeline.results()
        results.save(self._out)
        return encode_network(results.network)

    def _answer_map(self, _request: bytes) -> bytes:
        with self._lock:
            map_id = self._pipeline.map_id
        if map_id is None:
            raise OperationError("there is no map yet: no odometry of the first robot has come")
        return json.dumps({"map_id": str(map_id)}).encode()

    def _answer_reset(self, _request: bytes) -> bytes:
        with self._lock:
            self._pipeline = Pipeline(self._inputs)
            self._reported.clear()
            self._checkpoint.restart()
            for key, payload in self._announced.items():  # a camera says it once
                self._checkpoint.write(key, payload)
                message = cdr.decode(topics.CAMERA_INFO.type_name, payload)
                self._pipeline.push(topics.node_of(key), message)
        _log.info("reset: a new map begins with the next odometry message")
        return b"{}"

    def _answer_clock(self, _request: bytes) -> bytes:
        return json.dumps({"now_ns": self._clock.now_ns()}).encode()
