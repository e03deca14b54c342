"""What the estimator costs offline: a five-minute dance, and growth with length and cameras."""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.table import Row
from benchmarks.timing import worked
from trigpoint.contract.messages import Message, Odometry
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.calibrate.work import calibrated
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.world import load_world

from .corridor import Corridor

_NAME = "estimator"
_CAMERAS, _DURATION_S = 10, 120.0


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
    messages = list(corridor.messages())  # before the clock runs
    return worked(lambda: _offline(corridor.inputs, messages))[0]


def _offline(inputs: Inputs, messages: Iterable[tuple[str, Message]]) -> None:
    pipeline = Pipeline(inputs, is_live=False)
    for node, message in messages:
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance()
    pipeline.finish()
