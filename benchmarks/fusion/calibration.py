"""A recorded drive worked out: how fast, how near to the least error that is possible, and how time
grows with length and cameras. Work of one core, in processor time, where not said otherwise."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.study.session import fed
from benchmarks.table import Row, share_of
from benchmarks.timing import timed, worked
from trigpoint.fusion.estimators.results import Results
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.calibrate.work import calibrated
from trigpoint.tools.networks.bound import session_bound
from trigpoint.tools.networks.truth import load_truth, network_error
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.world import load_world

from .corridor import Corridor

SEEDS = (1, 2, 3)
_CAMERAS, _DURATION_S = 10, 120.0
_BOUND = "Cramér–Rao bound"


def run(effort: float = 1.0) -> list[Row]:
    """Calibrate the drive of each seed."""
    seeds = SEEDS[: share_of(len(SEEDS), effort)]
    drives = [_drive(seed) for seed in seeds]
    seconds, work, durations, errors, bounds = np.array(drives).T
    rows = [
        _time_row("a drive, reading included", seconds.mean(), durations.mean()),
        _time_row("the same, processor time", work.mean(), durations.mean()),
    ]
    for seed, error, bound in zip(seeds, errors, bounds, strict=True):
        rows.append(_error_row(f"mean distance error, seed {seed}", error, bound))
    rows.append(_error_row(f"the same, mean of {len(seeds)} seeds", errors.mean(), bounds.mean()))
    return [*rows, *_growth_rows(effort)]


def _growth_rows(effort: float) -> list[Row]:
    """A dance of five minutes; ten times the length, ten times the cameras."""
    small = _solved(Corridor(_CAMERAS, _DURATION_S))
    longer = _solved(Corridor(_CAMERAS, 10 * _DURATION_S * effort))
    wider = _solved(Corridor(round(10 * _CAMERAS * effort), 10 * _DURATION_S * effort))
    with TemporaryDirectory() as folder:
        world = load_world("dance", seed=1)
        write_session(world, Path(folder))
        work = worked(lambda: _calibrate(Path(folder)))[0]
    dance, against = "a dance of six cameras, reading included", "the dance's duration"
    return [
        Row("calibration", dance, "s", work, world.duration_s, against),
        Row("calibration", "10 × the length", "s", longer, small, "once the length"),
        Row("calibration", "10 × the cameras too", "s", wider, longer, "10 × the length"),
    ]


def _solved(corridor: Corridor) -> float:
    """Seconds to work a corridor's messages out."""
    messages = list(corridor.messages())  # before the clock runs
    return worked(lambda: fed(corridor.inputs, messages))[0]


def _error_row(what: str, error: float, bound: float) -> Row:
    return Row("calibration", what, "cm", 100 * float(error), 100 * float(bound), _BOUND)


def _time_row(what: str, ours: float, duration: float) -> Row:
    return Row("calibration", what, "s", float(ours), float(duration), "the drive's duration")


def _drive(seed: int) -> tuple[float, float, float, float, float]:
    """Seconds to calibrate, seconds of the processors' work in them, the drive's duration (s), its
    error and its bound (m)."""
    with TemporaryDirectory() as folder:
        path = Path(folder)
        world = load_world("drive", seed=seed)
        write_session(world, path)
        seconds, (work, results) = timed(lambda: worked(lambda: _calibrate(path)))
        error = network_error(results.network, results.covariance, load_truth(path / "truth.json"))
        if error.distance is None:
            raise AssertionError(f"seed {seed}: fewer than two cameras were located")
        recording = open_recording(path)
        inputs = session_inputs(recording, site=None, network=None)
        bound = session_bound(recording, inputs, path).mean_distance_error
        return seconds, work, world.duration_s, error.distance, bound


def _calibrate(folder: Path) -> Results:
    recording = open_recording(folder)
    return calibrated(recording, session_inputs(recording, site=None, network=None))
