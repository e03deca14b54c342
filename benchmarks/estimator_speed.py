"""What the estimator costs: a five-minute dance, growth with length and cameras, and live work."""

import multiprocessing
import resource
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from trigpoint.fusion.orders import News, Order
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.solving import Solving
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


def _live(corridor: Corridor) -> list[Row]:
    """In a process of its own, whose memory is then the live estimator's."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        milliseconds, worst, megabytes = pool.apply(_updates, (corridor,))
    what = f"{corridor.cameras} cameras, {corridor.duration_s / 60:.0f} min"
    return [
        Row(_NAME, f"live update, {what}, 99 %", "ms", milliseconds, 20.0, "the goal"),
        Row(_NAME, f"live update, {what}, the longest", "ms", worst, 20.0, "the goal"),
        Row(_NAME, f"live, {what}: resident", "MB", megabytes, 500.0, "the goal"),
    ]


class _Beside:
    """Solves in place of a process of its own, and keeps the time that it takes apart."""

    def __init__(self, inputs: Inputs) -> None:
        self._solving = Solving(inputs.data_set(), time.thread_time)
        self._news: list[News] = []
        self.seconds = 0.0

    def tell(self, orders: Sequence[Order]) -> None:
        began = time.thread_time()
        for order in orders:
            self._news.extend(self._solving.carry_out(order))
        self.seconds += time.thread_time() - began

    def news(self) -> list[News]:
        news, self._news = self._news, []
        return news

    def close(self) -> None:
        pass


def _updates(corridor: Corridor) -> tuple[float, float, float]:
    """99 % and the longest of the updates by a picture, ms, but for what another process does; the
    most memory, MB, of both together."""
    beside, took, has_sightings = _Beside(corridor.inputs), [], False
    pipeline = Pipeline(corridor.inputs, solver=beside)
    for node, message in corridor.messages():
        began = time.thread_time() - beside.seconds
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance()
            if has_sightings:
                took.append(time.thread_time() - beside.seconds - began)
            has_sightings = False
        has_sightings |= isinstance(message, Sightings)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return 1e3 * float(np.percentile(took, 99)), 1e3 * max(took), memory
