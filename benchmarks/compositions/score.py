"""`calibrate` over a drawn session, held against its truth."""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from trigpoint.geometry import Pose
from trigpoint.tools.networks.truth import joint_error

from .files import write_composition
from .session import Composition, composed_session

# A located camera is wrong where its position is further off than so many of its own sigmas; or
# than so many metres and a smaller number of sigmas.
WRONG_SIGMAS = 8.0
WRONG_M, WRONG_M_SIGMAS = 0.4, 5.0
GOAL_S, GOAL_SHARE = 10.0, 0.1  # of processor time: so much, and a share of the session's length
# Wall time on a busy machine, in multiples of the processor time that is allowed.
_PATIENCE = 8.0


class Outcome(StrEnum):
    """What came of a session."""

    DONE = "done"
    LATE = "late"
    FAILED = "failed"


class CameraScore(msgspec.Struct, frozen=True):
    """One camera. `status`: as in network.json, "" where there is none; `pictures`: with a good
    sighting of where it hung at last; `is_confirmed`: not resting on one sighting alone; `error_m`,
    `sigmas`: of its position where it is located; `among`: whether the true place is among the
    alternatives where such are named."""

    name: str
    status: str
    pictures: int
    is_confirmed: bool = True
    error_m: float | None = None
    sigmas: float | None = None
    among: bool | None = None

    @property
    def is_located(self) -> bool:
        return self.status == "located"

    @property
    def is_wrong(self) -> bool:
        """Whether it is located elsewhere than where it says."""
        if self.error_m is None or self.sigmas is None:
            return False
        is_far = self.error_m > WRONG_M and self.sigmas > WRONG_M_SIGMAS
        return self.sigmas > WRONG_SIGMAS or is_far


class Score(msgspec.Struct, frozen=True, tag=True):
    """One session. `honesty`: eᵀP⁻¹e/6n over the located cameras, None where none is or one is
    wrong; `seconds`: processor time; `lasts_s`: the session's length; `lifts`: of robots;
    `why`: it failed."""

    situation: str
    seed: int
    is_alike: bool
    is_mismatched: bool
    lifts: int
    outcome: Outcome
    seconds: float
    lasts_s: float
    cameras: list[CameraScore] = msgspec.field(default_factory=list)
    honesty: float | None = None
    why: str = ""
    estimator: str = "smoother"

    @property
    def wrong(self) -> list[CameraScore]:
        return [camera for camera in self.cameras if camera.is_wrong]

    @property
    def is_over_time(self) -> bool:
        return self.seconds > GOAL_S + GOAL_SHARE * self.lasts_s

    @property
    def is_bad(self) -> bool:
        return bool(self.wrong) or self.outcome is not Outcome.DONE


def scored(kind: str, seed: int, *, limit_s: float = 120.0) -> Score:
    """Draw a session, let `calibrate` work it out within a limit of processor time, judge it."""
    session = composed_session(kind, seed)
    with tempfile.TemporaryDirectory() as folder:
        directory = write_composition(session, Path(folder))
        out = Path(folder, "calibration")
        code, seconds, said = _calibrated(directory, out, limit_s)
        return score_of(session, out, code, seconds, said)


def score_of(session: Composition, out: Path, code: int | None, seconds: float, said: str) -> Score:
    """The score of what `calibrate` left in `out`. `code`: its exit status, None where the time was
    over; `said`: its standard error."""
    recipe = session.recipe
    outcome, why = Outcome.DONE, ""
    if code is None:
        outcome = Outcome.LATE
    elif code or not (out / "network.json").exists():
        lines = said.strip().splitlines()
        outcome, why = Outcome.FAILED, f"exit {code}: {lines[-1] if lines else ''}"[:160]
    said_of = _said_of_cameras(out) if outcome is Outcome.DONE else {}
    places, pictures = session.last_places(), session.pictures_at_last()
    cameras = [
        _camera(name, said_of.get(name), place, pictures[name]) for name, place in places.items()
    ]
    is_any_wrong = any(camera.is_wrong for camera in cameras)
    return Score(
        situation=recipe.kind,
        seed=recipe.seed,
        is_alike=recipe.is_alike,
        is_mismatched=recipe.is_mismatched,
        lifts=recipe.lifts,
        outcome=outcome,
        seconds=seconds,
        lasts_s=session.lasts_s,
        cameras=cameras,
        honesty=None if is_any_wrong else _honesty(out, said_of, places),
        why=why,
    )


def _calibrated(directory: Path, out: Path, limit_s: float) -> tuple[int | None, float, str]:
    """Exit status (None: over the limit), processor seconds, and standard error."""
    command = [sys.executable, "-m", "trigpoint", "calibrate", str(directory / "session.mcap")]
    command += ["--site", str(directory / "site.toml"), "--out", str(out)]
    # Sessions are worked out side by side, and leave nothing for the linear algebra's threads.
    one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=said, env=os.environ | one_thread
        )
        limits = (int(np.ceil(limit_s)), int(np.ceil(limit_s)) + 1)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, limits)
        end = threading.Timer(_PATIENCE * limit_s, process.kill)
        end.start()
        try:
            _, status, used = os.wait4(process.pid, 0)
        finally:
            end.cancel()
        process.returncode = code = os.waitstatus_to_exitcode(status)
        said.seek(0)
        seconds = used.ru_utime + used.ru_stime
        # A signal ended it: the one of the limit, or the timer's.
        is_over = code == -signal.SIGXCPU or (code < 0 and seconds >= 0.9 * limit_s)
        return (None if is_over else code), seconds, said.read()


def _said_of_cameras(out: Path) -> dict[str, dict[str, Any]]:
    network: dict[str, Any] = json.loads((out / "network.json").read_text())
    return network["cameras"]


def _camera(name: str, said: dict[str, Any] | None, place: Pose, pictures: int) -> CameraScore:
    if said is None or not said.get("map_from_camera"):
        status = said["status"] if said else ""
        return CameraScore(name, status, pictures, among=_among(said, place))
    error = _pose(said["map_from_camera"]).difference(place)[:3]
    position = np.reshape(said["covariance"], (6, 6))[:3, :3]
    sigmas = float(np.sqrt(error @ np.linalg.pinv(position) @ error))
    length = float(np.linalg.norm(error))
    is_confirmed = bool(said.get("confirmed", True))
    return CameraScore(name, said["status"], pictures, is_confirmed, length, sigmas)


def _among(said: dict[str, Any] | None, place: Pose) -> bool | None:
    """Whether the true place is one of the alternatives."""
    named = said.get("alternatives") if said else None
    if not named:
        return None
    for one in named:
        error = _pose(one["map_from_camera"]).difference(place)[:3]
        position = np.reshape(one["covariance"], (6, 6))[:3, :3]
        if error @ np.linalg.pinv(position) @ error < WRONG_SIGMAS**2:
            return True
    return False


def _honesty(
    out: Path, said_of: dict[str, dict[str, Any]], places: dict[str, Pose]
) -> float | None:
    located = [n for n, said in said_of.items() if said.get("map_from_camera") and n in places]
    if not located or not (out / "covariance.npz").exists():
        return None
    with np.load(out / "covariance.npz") as archive:
        order, joint = [str(name) for name in archive["cameras"]], archive["covariance"]
    rows = np.concatenate([6 * order.index(name) + np.arange(6) for name in located])
    estimated = [_pose(said_of[name]["map_from_camera"]) for name in located]
    return joint_error(estimated, [places[name] for name in located], joint[np.ix_(rows, rows)])


def _pose(said: dict[str, Any]) -> Pose:
    return Pose.from_quaternion(said["translation"], said["quaternion"])
