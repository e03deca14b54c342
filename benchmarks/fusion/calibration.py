"""A recorded drive worked out: how fast, and how time grows with length and cameras. Work of one
core, in processor time."""

from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.study.session import fed
from benchmarks.table import Row
from benchmarks.timing import worked
from trigpoint.fusion.estimators.results import Results
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.calibrate.work import calibrated
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.world import load_world

from .corridor import Corridor

_CAMERAS, _DURATION_S = 10, 120.0


def run(effort: float = 1.0) -> list[Row]:
    """The demo's drive, a dance of five minutes; ten times the length, ten times the cameras."""
    small = _solved(Corridor(_CAMERAS, _DURATION_S))
    longer = _solved(Corridor(_CAMERAS, 10 * _DURATION_S * effort))
    wider = _solved(Corridor(round(10 * _CAMERAS * effort), 10 * _DURATION_S * effort))
    return [
        _time_row("a drive, reading included", "drive"),
        _time_row("a dance of six cameras, reading included", "dance"),
        Row("calibration", "10 × the length", "s", longer, small, "once the length"),
        Row("calibration", "10 × the cameras too", "s", wider, longer, "10 × the length"),
    ]


def _time_row(what: str, name: str) -> Row:
    world = load_world(name, seed=1)
    with TemporaryDirectory() as folder:
        write_session(world, Path(folder))
        work = worked(lambda: _calibrate(Path(folder)))[0]
    return Row("calibration", what, "s", work, world.duration_s, "its duration")


def _solved(corridor: Corridor) -> float:
    """Seconds to work a corridor's messages out."""
    messages = list(corridor.messages())  # before the clock runs
    return worked(lambda: fed(corridor.inputs, messages))[0]


def _calibrate(folder: Path) -> Results:
    recording = open_recording(folder)
    return calibrated(recording, session_inputs(recording, site=None, network=None))
