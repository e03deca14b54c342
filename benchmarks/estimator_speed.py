"""What the estimator costs: a five-minute dance, growth with length and cameras, and live work."""

import resource
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from trigpoint import cdr
from trigpoint.clock import to_ns
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.solver_process import SolverProcess
from trigpoint.messages import Message, Odometry, Sightings
from trigpoint.recorder.recording import open_recording
from trigpoint.tools.calibrate import calibrated
from trigpoint.tools.session_inputs import session_inputs
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.world import load_world

from .corridor import Corridor
from .table import Row
from .timing import worked

_NAME = "estimator"
_CAMERAS, _DURATION_S = 10, 120.0
_LIVE = Corridor(cameras=100, duration_s=3600.0)
# So far the session runs ahead of its solver at most, and how often the estimator then looks.
_LEAD_S = 30.0
_TURN_S = 0.05


def run(effort: float = 1.0) -> list[Row]:
    """Work of one core, in processor time: the machine may be busy."""
    small = _solved(Corridor(_CAMERAS, _DURATION_S))
    longer = _solved(Corridor(_CAMERAS, 10 * _DURATION_S * effort))
    wider = _solved(Corridor(round(10 * _CAMERAS * effort), 10 * _DURATION_S * effort))
    duration, seconds = _dance()
    return [
        Row(
            _NAME,
            "calibrate a dance of six cameras, reading included",
            "s",
            seconds,
            duration,
            "the dance's duration",
        ),
        Row(_NAME, "10 × the length: seconds", "s", longer, small, "once the length"),
        Row(
            _NAME, "10 × the length and the cameras: seconds", "s", wider, longer, "10 × the length"
        ),
        *_live(Corridor(_LIVE.cameras, _LIVE.duration_s * effort)),
    ]


def _dance() -> tuple[float, float]:
    """Its duration and the time that calibrating it takes, seconds."""
    with TemporaryDirectory() as folder:
        world = load_world("dance", seed=1)
        write_session(world, Path(folder))

        def calibrate() -> None:
            recording = open_recording(Path(folder))
            calibrated(recording, session_inputs(recording, site=None, network=None))

        return world.duration_s, worked(calibrate)[0]


def _solved(corridor: Corridor) -> float:
    """Seconds to work a corridor's messages out."""
    messages = list(corridor.messages())
    return worked(lambda: _offline(corridor.inputs, messages))[0]


def _offline(inputs: Inputs, messages: list[tuple[str, Message]]) -> None:
    pipeline = Pipeline(inputs, is_live=False)
    for node, message in messages:
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance()
    pipeline.finish()


@dataclass(frozen=True, slots=True)
class _Live:
    """What a live session cost: milliseconds of each turn with a sighting, (n,); the most memory
    of the estimator's process and of its solver's, MB; the solver's share of a core, at the pace of
    the session."""

    milliseconds: np.ndarray
    megabytes: float
    solver_megabytes: float
    solver_share: float


def _live(corridor: Corridor) -> list[Row]:
    """In a process of its own, whose memory is then the live estimator's."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        live = pool.submit(_driven, corridor).result()
    what = f"live, {corridor.cameras} cameras, {corridor.duration_s / 60:.0f} min"
    middle, most = np.percentile(live.milliseconds, [50, 99]).tolist()
    longest = float(live.milliseconds.max())
    together = live.megabytes + live.solver_megabytes
    return [
        Row(_NAME, f"{what}: an update, 50 %", "ms", middle, 20.0, "the goal of 99 %"),
        Row(_NAME, f"{what}: an update, 99 %", "ms", most, 20.0, "the goal"),
        Row(_NAME, f"{what}: an update, the longest", "ms", longest, 20.0, "the goal of 99 %"),
        Row(
            _NAME, f"{what}: resident, without its solver", "MB", live.megabytes, 500.0, "the goal"
        ),
        Row(_NAME, f"{what}: resident, with its solver", "MB", together, 500.0, "the goal"),
        Row(_NAME, f"{what}: the solver's share of a core", "", live.solver_share, 1.0, "one core"),
    ]


def _driven(corridor: Corridor) -> _Live:
    """Drive along a corridor with a solver beside, as the node does it.

    Messages come as quickly as they are used, since an hour would take an hour; so that the solver
    has its time all the same, it is waited for after every so many seconds of the session.
    """
    solver = SolverProcess(corridor.inputs.data_set())
    try:
        took = _fed(Pipeline(corridor.inputs, solver=solver), corridor)
    finally:
        solver.close()
    mine = resource.getrusage(resource.RUSAGE_SELF)
    solvers = resource.getrusage(resource.RUSAGE_CHILDREN)
    share = (solvers.ru_utime + solvers.ru_stime) / corridor.duration_s
    return _Live(1e3 * np.array(took), mine.ru_maxrss / 1024, solvers.ru_maxrss / 1024, share)


def _fed(pipeline: Pipeline, corridor: Corridor) -> list[float]:
    """The processor's seconds of the turns that had a sighting, what is sent by them included."""
    took, has_sightings, waited_ns = [], False, 0
    for node, message in corridor.messages():
        began = time.thread_time()
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            for output in pipeline.advance(message.stamp_ns):
                cdr.encode(output.message)
            if has_sightings:
                took.append(time.thread_time() - began)
            has_sightings = False
            if message.stamp_ns - waited_ns >= to_ns(_LEAD_S):
                waited_ns = message.stamp_ns
                _wait(pipeline)
        has_sightings |= isinstance(message, Sightings)
    return took


def _wait(pipeline: Pipeline) -> None:
    """Until the solver has done everything that it was told."""
    pipeline.ask()
    while not pipeline.is_answered:
        time.sleep(_TURN_S)
        pipeline.advance()
