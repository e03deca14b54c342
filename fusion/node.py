"""The live estimator on the bus: messages to the pipeline, its outputs to their keys."""

import json
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.base.disk import free_bytes
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import OperationError
from trigpoint.bus.bus import Bus, Sample
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import CameraInfo, Diagnostics, Message, OccupancyGrid
from trigpoint.contract.topics import command_key
from trigpoint.map.network import encode_network
from trigpoint.node.node import Node
from trigpoint.node.peers import SERVERS
from trigpoint.node.watchdog import Pulse
from trigpoint.security.authenticator import correction_signer

from .checkpoint import CHECKPOINT
from .coverage.announced import AnnouncedMap
from .diagnostics import Diagnostics as InputDiagnostics
from .estimators.results import Results
from .fair_lock import FairLock
from .fixed.network import FixedNetwork
from .holding import Holding
from .inbox import Inbox
from .intake.admission import Admission
from .last_solution import ANSWER_S, WRITING_S, save_last, solved
from .live.coverage_thread import cover
from .live.solver_messages import Solver
from .map_storage import MapStorage, Stored
from .model.inputs import Inputs
from .model.readings import Readings
from .output import Output
from .pipeline_maker import PipelineMaker
from .publishing import Publishing
from .replaying import Replay
from .solution_file import SolutionFile

KIND = "fusion"
NAME = SERVERS[KIND]

# An arriving message ends the wait; without one, turns are this far apart.
_TURN_S = 0.02
# A turn uses so many observations of a robot at most; so commands, which wait for its end, and a
# stop are answered whatever comes.
_MOST_USED = 16
_LAST_TAKING_NS = to_ns(0.25)
# While a checkpoint is read, what comes is taken in, and commands may come, every so many messages.
_READ_AT_ONCE = 1024
# A turn of a filter that has fallen behind on a small machine; beyond it the thread is hung.
_TURN_MOST_S = 60.0
# A map of corrections among a hundred cameras, on a small machine.
_COVER_S = 120.0

_log = logging.getLogger(__name__)


class FusionNode:
    """One site's estimator. The pipeline is used under a lock, but for its counters."""

    def __init__(
        self,
        bus: Bus,
        node: Node,
        inputs: Inputs,
        out: Path,
        clock: Clock,
        *,
        solver: Callable[[Inputs], Solver] | None = None,
        fixed: FixedNetwork | None = None,
    ) -> None:
        """`solver`: makes the solver of one map, so that no turn takes long; `fixed`: the network
        that is held from the beginning."""
        self._bus, self._node, self._inputs, self._clock = bus, node, inputs, clock
        self._site, self._out = inputs.site, out
        self._holding = Holding(fixed, learns=fixed is None and inputs.site.fusion.learn)
        self._maker = PipelineMaker(inputs, out, solver)
        self._solution = SolutionFile(out, inputs)
        self._lock = FairLock()
        self._admission = Admission(inputs.site)
        self._pipeline = self._maker.make(self._holding.fixed, is_live=False)
        self._announced: dict[str, bytes] = {}
        signer = correction_signer(inputs.site, clock)
        self._diagnostics = InputDiagnostics(inputs.site, self._admission)
        self._inbox = Inbox(bus, node, clock, self._admission, self._diagnostics)
        self._publishing = Publishing(bus, inputs.site, node.health, signer, self._inbox.delays)
        self._grids = deque[OccupancyGrid](maxlen=1)  # to be sent
        self._longest_s = 0.0
        self._path = out / CHECKPOINT
        self._storage: MapStorage | None = None
        self._is_read = threading.Event()  # the checkpoint; before it the map is not whole

    def start(self) -> None:
        """Subscribe, serve the commands, and start the working thread."""
        name = self._site.name
        self._inbox.open(name)
        self._node.health.gauge("waiting", lambda: self._pipeline.waiting)
        count, cameras = lambda: self._pipeline.located_count, len(self._site.cameras)
        self._node.health.gauge("cameras_located", count)
        self._node.health.gauge("cameras_undetermined", lambda: cameras - count())
        self._node.health.gauge("worst_sigma_m", lambda: self._publishing.accuracy.worst_sigma_m)
        self._node.health.gauge("disk_free_bytes", lambda: free_bytes(self._out))
        for path, answer in (
            ("fusion/network", self._answer_network),
            ("fusion/map", self._answer_map),
            ("fusion/reset", self._answer_reset),
            ("fusion/learn", self._answer_learn),
            ("clock", self._answer_clock),
        ):
            self._bus.serve(command_key(name, path), answer)
        self._node.work("estimates", self._run, within_s=_TURN_MOST_S)
        stopping = self._node.stopping
        self._node.work("keeps", lambda p: self._solution.run(p, stopping), within_s=_TURN_MOST_S)
        self._node.work("covers", self._cover, within_s=_COVER_S)

    def finish(self) -> None:
        """Write the results, solved to the end where that is quick enough for a stop, after the
        working thread has ended. Raises OperationError where what should be written is not."""
        if not self._lock.acquire(ENDING.left_s(WRITING_S) if ENDING.is_asked else -1.0):
            raise OperationError(
                f"no network is written: the estimator is still at work; all that came in is in "
                f"{self._path}, and `trigpoint fusion` started again goes on from there"
            )
        try:
            if self._storage is not None:
                with ENDING.writing():
                    self._storage.close()
            if self._holding.fixed is not None:
                _log.info("the map is fixed: its network stays as it is, and nothing is written")
            elif self.is_resumed:
                turn_s = self._longest_s if self._maker.solver is None else None
                save_last(self._pipeline, self._out, self._clock, turn_s=turn_s)
                self._solution.keep(self._pipeline)
                self._solution.write()
            else:
                _log.info("stopped before %s was read; all of it is still there", self._path)
            if self._storage is not None and self._storage.trouble:
                raise OperationError(self._storage.trouble)
        finally:
            self._lock.release()
            self._maker.close()

    # -- the working thread -----------------------------------------------------------------------

    def _run(self, pulse: Pulse) -> None:
        if self._holding.fixed is None and not self._resume(pulse):
            return
        self._is_read.set()
        while not self._node.stopping.is_set():
            pulse.beat()
            if not self._switch(pulse):
                return
            self._inbox.wait(0.0 if self._pipeline.is_behind else _TURN_S)
            with self._lock:
                outputs = self._turn()
            self._publishing.send_all(outputs)
            self._report()
        with self._lock:
            self._take_last()

    def _take_last(self) -> None:
        """Take in what had come before the stop, for a part of the time that a stop has."""
        until_ns = self._clock.elapsed_ns() + _LAST_TAKING_NS
        while not self._inbox.is_empty and self._clock.elapsed_ns() < until_ns:
            self._take_in()

    def _take_in(self) -> None:
        for sample, message in self._arrived():
            self._push(sample, message)

    def _arrived(self) -> Iterator[tuple[Sample, Message]]:
        """What has come. Cameras announce their intrinsics once, so these are remembered."""
        for sample, message in self._inbox.messages():
            if isinstance(message, CameraInfo):
                self._announced[sample.key] = sample.payload
            yield sample, message

    def _turn(self) -> list[Output]:
        """Take in and use what has come; the messages to send."""
        self._take_in()
        began_ns = self._clock.elapsed_ns()
        self._pipeline.is_clock_set = bool(self._node.clock_set_by_ns)
        outputs = self._pipeline.advance(self._clock.now_ns(), most=_MOST_USED)
        took_s = to_seconds(self._clock.elapsed_ns() - began_ns)
        self._longest_s = max(self._longest_s, took_s)
        if self._storage is not None:
            self._storage.settle(self._pipeline.past)
            self._storage.flush()
            self._solution.keep(self._pipeline)
        while self._grids:
            outputs.append(Output(topics.COVERAGE_GRID, "", self._grids.popleft()))
        return outputs

    def _push(self, sample: Sample, message: Message) -> None:
        """Hand a message to the pipeline, and store it where it may add to the map."""
        if self._pipeline.push(topics.node_of(sample.key), message):
            self._store(sample, message)

    def _store(self, sample: Sample, message: Message) -> None:
        if self._holding.fixed is not None:
            return
        lost = self._open_storage.store(sample.key, sample.payload, message)
        if lost:
            self._node.health.lose("checkpoint", lost)

    def _cover(self, pulse: Pulse) -> None:
        announced = AnnouncedMap(self._site, self._inputs.targets)
        wait = self._node.stopping.wait
        cover(announced, self._covered, self._grids.append, wait=wait, beat=pulse.beat)

    def _covered(self) -> Results | None:
        """What the map of corrections is made of; None where a solver makes it, or of nothing."""
        with self._lock:
            if self._maker.solver is not None or not self._pipeline.located_count:
                return None
            return self._pipeline.results()

    def _report(self) -> None:
        """Put what was left out, and what is wrong or went wrong, into the diagnostics."""
        health, storage = self._node.health, self._storage
        health.describe("map", "" if self._holding.learns else self._holding.state)
        trouble = storage.trouble if storage is not None else ""
        now_ns = self._clock.elapsed_ns()
        self._diagnostics.report(self._pipeline, health, now_ns, checkpoint=trouble)

    # -- learning, or not -------------------------------------------------------------------------

    def _switch(self, pulse: Pulse) -> bool:
        """Hold the map, or learn it again, where that is wanted; False where a stop came first."""
        holding = self._holding
        if holding.is_to_learn_again:
            with self._lock:
                self._is_read.clear()
                holding.hold(None)
                self._pipeline = self._maker.make(None, is_live=False)
            if not self._resume(pulse):
                return False
            with self._lock:
                self._announce_again()
            self._is_read.set()
        elif holding.is_to_be_held:
            with self._lock:
                self._hold()
        return True

    def _hold(self) -> None:
        """Have what came solved to the end; once it is, hold that."""
        holding, pipeline = self._holding, self._pipeline
        if not holding.is_asked:
            pipeline.finish()
            holding.is_asked = True
        if not pipeline.reports.is_answered:
            return
        results = pipeline.results()
        try:
            fixed = FixedNetwork.of(results, self._site, pipeline.conclusions)
        except OperationError as reason:
            if not self._site.fusion.learn:
                raise
            holding.want(learns=True)
            self._node.health.fail(str(reason))
            return
        results.save(self._out)
        self._open_storage.close()
        self._storage = None
        self._solution.forget()  # what comes meanwhile is not stored
        holding.hold(fixed)
        self._pipeline = self._maker.make(fixed)
        self._diagnostics.restart()
        self._announce_again()
        _log.info("the map is fixed, as it is in %s", self._out / "network.json")

    def _announce_again(self) -> None:
        """Tell a new pipeline the intrinsics, which a camera says once."""
        for key, payload in self._announced.items():
            message = cdr.decode(topics.CAMERA_INFO.type_name, payload)
            if self._pipeline.push(topics.node_of(key), message) and self._storage is not None:
                self._storage.store(key, payload, message)

    # -- the checkpoint ---------------------------------------------------------------------------

    @property
    def _open_storage(self) -> MapStorage:
        if self._storage is None:  # the working thread opens it first
            raise OperationError("fusion is just starting; ask again in a moment")
        return self._storage

    @property
    def is_resumed(self) -> bool:
        """Whether the checkpoint was read; nothing is estimated before."""
        return self._is_read.is_set()

    def _resume(self, pulse: Pulse) -> bool:
        """Resume the map that a killed fusion left; on the working thread. Messages that come
        meanwhile are set aside and used afterwards. False where a stop came first."""
        with self._lock:
            knows, past = self._admission.knows, self._pipeline.past
            self._storage = MapStorage(self._out, self._site, self._clock, knows=knows, past=past)
        pipeline, count = self._pipeline, 0
        replay, stored = Replay(pipeline), self._storage.read(_READ_AT_ONCE)
        aside: list[tuple[Sample, Message]] = []
        for some in stored:
            pulse.beat()
            if self._node.stopping.is_set():
                for sample, message in aside:
                    if pipeline.is_to_be_stored(topics.node_of(sample.key), message):
                        self._store(sample, message)
                return False
            if not count:
                _log.info("reading %s; nothing is estimated until that is done", self._path)
            with self._lock:
                if self._pipeline is not pipeline:
                    return True  # reset
                count += sum(self._take_again(replay, *each) for each in some)
                replay.flush()
                aside += self._arrived()
        with self._lock:
            if self._pipeline is pipeline:
                self._go_on(count)
                for sample, message in aside:
                    self._push(sample, message)
        return True

    def _take_again(self, replay: Replay, key: str, stored: Stored) -> int:
        """Take what the checkpoint has; how many messages."""
        if isinstance(stored, Diagnostics):
            replay.take_moves(stored)
            return 1
        replay.take(topics.node_of(key), stored)
        if isinstance(stored, CameraInfo):
            self._announced[key] = cdr.encode(stored)
        return len(stored) if isinstance(stored, Readings) else 1

    def _go_on(self, count: int) -> None:
        """Go on live after so many messages of a checkpoint."""
        self._pipeline.advance()
        is_new = not count and self._pipeline.past is None
        solution = self._solution.load(self._pipeline.map_id, self._clock.now_ns())
        goes_on = self._pipeline.resumed(is_new=is_new, solution=solution)
        if not is_new:
            _log.info(
                "map %s resumed from %s (%d messages)%s; the command %s starts a new one",
                *(self._pipeline.map_id, self._path, count),
                "" if goes_on else "; there are no corrections before it is solved",
                command_key(self._site.name, "fusion/reset"),
            )

    # -- commands, on the bus's threads -----------------------------------------------------------

    def _wait_for_the_checkpoint(self) -> None:
        """Refuse commands until the checkpoint is read, since the map is incomplete."""
        if not self._is_read.wait(ANSWER_S):
            raise OperationError(f"fusion is still reading {self._path}; ask again in a moment")

    def _answer_network(self, _request: bytes) -> bytes:
        self._wait_for_the_checkpoint()
        results = solved(lambda: self._pipeline, self._lock, self._clock, self._node.stopping)
        if self._holding.fixed is None:
            results.save(self._out)
        return encode_network(results.network)

    def _answer_map(self, _request: bytes) -> bytes:
        self._wait_for_the_checkpoint()
        with self._lock:
            map_id = self._pipeline.map_id
        if map_id is None:
            raise OperationError("there is no map yet: no odometry of the first robot has come")
        return json.dumps({"map_id": str(map_id)}).encode()

    def _answer_reset(self, _request: bytes) -> bytes:
        with self._lock:
            self._holding.check_is_learnt(command_key(self._site.name, "fusion/learn"))
            self._open_storage.restart()
            self._pipeline = self._maker.make(self._holding.fixed)
            self._diagnostics.restart()
            self._node.health.describe("cameras", "")
            self._announce_again()
        _log.info("reset: a new map begins with the next odometry message")
        return b"{}"

    def _answer_learn(self, request: bytes) -> bytes:
        self._wait_for_the_checkpoint()
        with self._lock:
            return self._holding.answered(request, has_map=self._pipeline.located_count > 0)

    def _answer_clock(self, _request: bytes) -> bytes:
        return json.dumps({"now_ns": self._clock.now_ns()}).encode()
