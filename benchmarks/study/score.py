"""`calibrate` over a drawn session, held against its truth."""

import os
import resource
import signal
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.session import Composition, composed_session
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import CameraRecord, PoseRecord, load_covariance, load_network
from trigpoint.tools.networks.truth import CameraError, TruthFile, network_error

from .result import Camera, Outcome, Result, Verdict

# A located camera is wrong where its position is further off than so many of its own sigmas; or
# than so many metres and a smaller number of sigmas.
WRONG_SIGMAS = 8.0
WRONG_M, WRONG_M_SIGMAS = 0.4, 5.0
GOAL_S, GOAL_SHARE = 10.0, 0.1  # of processor time: so much, and a share of the session's length
# Wall time on a busy machine, in multiples of the processor time that is allowed.
_PATIENCE = 8.0


def scored(kind: str, seed: int, *, limit_s: float = 120.0) -> Result:
    """Draw a session, let `calibrate` work it out within a limit of processor time, judge it."""
    session = composed_session(kind, seed)
    with tempfile.TemporaryDirectory() as folder:
        directory = write_composition(session, Path(folder))
        out = Path(folder, "calibration")
        code, seconds, said = _calibrated(directory, out, limit_s)
        return score_of(session, out, code, seconds, said)


def score_of(
    session: Composition, out: Path, code: int | None, seconds: float, said: str
) -> Result:
    """The score of what `calibrate` left in `out`. `code`: its exit status, None where the time was
    over; `said`: its standard error."""
    recipe = session.recipe
    outcome, why = Outcome.DONE, ""
    if code is None:
        outcome = Outcome.LATE
    elif code or not (out / "network.json").exists():
        lines = said.strip().splitlines()
        outcome, why = Outcome.FAILED, f"exit {code}: {lines[-1] if lines else ''}"[:160]
    cameras, error = [], None
    network = load_network(out) if outcome is Outcome.DONE else None
    places, pictures = session.last_places(), session.pictures_at_last()
    if network is not None:
        truth = TruthFile({name: PoseRecord.of(place) for name, place in places.items()})
        error = network_error(network, load_covariance(out, network), truth)
    for name, place in places.items():
        record = network.cameras.get(name) if network is not None else None
        mine = error.cameras.get(name) if error is not None else None
        cameras.append(_camera(name, record, mine, place, pictures[name]))
    is_wrong = any(camera.verdict is Verdict.WRONG for camera in cameras)
    honesty = None if error is None or is_wrong else error.nees
    return Result(
        session=recipe.kind,
        seed=recipe.seed,
        seconds=seconds,
        cameras=cameras,
        honesty=honesty,
        outcome=outcome,
        why=why,
        is_alike=recipe.is_alike,
        is_mismatched=recipe.is_mismatched,
        lifts=recipe.lifts,
        lasts_s=session.lasts_s,
    )


def _calibrated(directory: Path, out: Path, limit_s: float) -> tuple[int | None, float, str]:
    """Exit status (None: over the limit), processor seconds, and standard error."""
    command = [sys.executable, "-m", "trigpoint", "calibrate", str(directory / "session.mcap")]
    command += ["--site", str(directory / "site.toml"), "--out", str(out)]
    # Sessions are worked out side by side, and leave nothing for the linear algebra's threads.
    one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    limits = (int(np.ceil(limit_s)), int(np.ceil(limit_s)) + 1)
    before_s = _children_s()
    try:
        ran = subprocess.run(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | one_thread,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_CPU, limits),
            timeout=_PATIENCE * limit_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None, _children_s() - before_s, ""
    seconds = _children_s() - before_s
    is_late = ran.returncode == -signal.SIGXCPU
    return (None if is_late else ran.returncode), seconds, ran.stderr


def _children_s() -> float:
    """The processor's time of all processes that this one began and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _camera(
    name: str, said: CameraRecord | None, error: CameraError | None, place: Pose, pictures: int
) -> Camera:
    """`error`: where it is located."""
    if said is None or error is None:
        return Camera(name, Verdict.UNKNOWN, pictures=pictures, among=_among(said, place))
    is_far = error.position > WRONG_M and error.sigmas > WRONG_M_SIGMAS
    return Camera(
        name,
        Verdict.WRONG if is_far or error.sigmas > WRONG_SIGMAS else Verdict.RIGHT,
        pictures=pictures,
        is_confirmed=said.confirmed,
        error_m=error.position,
        sigmas=error.sigmas,
    )


def _among(said: CameraRecord | None, place: Pose) -> bool | None:
    """Whether the true place is one of the alternatives."""
    if said is None or not said.alternatives:
        return None
    return any(
        _sigmas(one.map_from_camera.pose.difference(place)[:3], np.array(one.covariance))
        < WRONG_SIGMAS
        for one in said.alternatives
    )


def _sigmas(error: Array, covariance: Array) -> float:
    """Of a position's error (3,) by its pose's covariance."""
    position = covariance.reshape(6, 6)[:3, :3]
    return float(np.sqrt(error @ np.linalg.pinv(position) @ error))
