"""The gate refuses every bad correction, and no true one.

A robot drives a winding way whose odometry errs as the site file says; true corrections with the
errors that they claim come ten times a second, and between them bad ones of every kind. Errors of
consecutive corrections are independent, or hang together over five seconds, as those of one camera
do. Nothing random is left to chance: the seed decides.
"""

import math
from collections import Counter
from collections.abc import Callable
from uuid import UUID

import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract.correction import CorrectionMark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
from trigpoint.robot.gate.safety import Approved, Refused, SafetyGate
from trigpoint.robot.odometry.odometry import Stamped
from trigpoint.site.config import OdometryNoise, RobotConfig

MAP, OTHER_MAP = UUID(int=1), UUID(int=2)
BEGIN_NS = to_ns(1000.0)
PERIOD_NS = to_ns(0.02)
AGE_NS = to_ns(0.1)
EVERY = 5  # readings from one correction to the next
_DRIVES = 20
# Sigmas of corrections, m and rad: what fusion claims in the demo is at the lower end.
SIGMAS = [(0.005, 0.005), (0.01, 0.01), (0.05, 0.03)]


class Drive:
    """The robot, its odometry and its gate; `memory_s` of the corrections' errors."""

    def __init__(self, seed: int, memory_s: float, sigmas: tuple[float, float]) -> None:
        self.random = np.random.default_rng(seed)
        noise = OdometryNoise(distance_scale=0.005, heading_scale=0.005)
        self.config = RobotConfig(port="x", odometry=noise)
        self.gate = SafetyGate(self.config)
        self.covariance = np.diag([sigmas[0] ** 2, sigmas[0] ** 2, 0, 0, 0, sigmas[1] ** 2])
        self.keep = math.exp(-EVERY * 0.02 / memory_s) if memory_s else 0.0
        self.error = self._draw()
        self.scale = 1 + 0.005 * self.random.standard_normal(2)
        self.now_ns, self.truth, self.odom = BEGIN_NS, Pose.planar(3, 2, 1), Pose.identity()
        self.past: list[tuple[int, Pose]] = []
        self.sequence = 0
        self.tick = 0

    def _draw(self) -> np.ndarray:
        sigmas = np.sqrt(np.diag(self.covariance))
        return sigmas * self.random.standard_normal(6)

    def advance(self) -> None:
        """One reading: 0.4 m/s along a way that turns left and right."""
        self.tick += 1
        self.now_ns += PERIOD_NS
        length, turn = 0.4 * 0.02, 0.6 * 0.02 * math.sin(0.02 * self.tick / 7)
        # True motion is the reported one with the contract's noise and the scale errors.
        variances = step_variances(self.config.odometry, length, abs(turn))
        sigmas = np.sqrt([*variances.translation[:2], variances.rotation[2]])
        along, across, swerve = sigmas * self.random.standard_normal(3)
        turned = turn * self.scale[1] + swerve
        self.odom = self.odom @ Pose.planar(length, 0, turn)
        self.truth = self.truth @ Pose.planar(length * self.scale[0] + along, across, turned)
        self.gate.add_odometry(Stamped(self.now_ns, self.now_ns, self.odom))
        self.past = [*self.past[-60:], (self.now_ns, self.truth)]

    def good(self) -> PoseEstimate:
        """A correction with the error that it claims."""
        fresh = math.sqrt(1 - self.keep**2)
        self.error = self.keep * self.error + fresh * self._draw()
        stamp_ns, pose = next(e for e in self.past if e[0] >= self.now_ns - AGE_NS)
        return PoseEstimate(stamp_ns, "map", pose.disturbed(self.error), self.covariance)

    def judge(
        self, correction: PoseEstimate, *, map_id: UUID = MAP, sender: str = "fusion"
    ) -> Approved | Refused:
        self.sequence += 1
        if self.gate.asks:
            self.gate.hear([MAP], self.now_ns)
        mark = CorrectionMark(map_id, self.sequence)
        return self.gate.judge(correction, mark, self.now_ns, sender)

    def place(self) -> None:
        """Drive until the robot is placed."""
        for _ in range(600):
            self.advance()
            if self.tick % EVERY == 0 and isinstance(self.judge(self.good()), Approved):
                return
        raise RuntimeError("the robot was not placed")

    def jump(self, least: float) -> PoseEstimate:
        """A correction at `least` sigmas or more of the propagated uncertainty, any direction."""
        good = self.good()
        at = self.gate.history.at(good.stamp_ns)
        placement = self.gate._placement
        assert at is not None
        assert placement is not None
        expected, covariance = placement.believed(self.gate.history, at)
        rows = np.ix_([0, 1, 5], [0, 1, 5])
        direction = self.random.standard_normal(3)
        direction *= (least + self.random.exponential(3.0)) / np.linalg.norm(direction)
        shown = np.linalg.cholesky((covariance + good.covariance)[rows]) @ direction
        disturbance = np.zeros(6)
        disturbance[[0, 1, 5]] = shown
        return replace(good, pose=expected.disturbed(disturbance))


Bad = Callable[[Drive], Approved | Refused]


def _changed(change: Callable[[Drive, PoseEstimate], PoseEstimate]) -> Bad:
    return lambda drive: drive.judge(change(drive, drive.good()))


def _with_covariance(change: Callable[[np.ndarray], None]) -> Bad:
    def changed(_drive: Drive, good: PoseEstimate) -> PoseEstimate:
        covariance = good.covariance.copy()
        change(covariance)
        return replace(good, covariance=covariance)

    return _changed(changed)


def _set(row: int, column: int, value: float) -> Bad:
    def change(covariance: np.ndarray) -> None:
        covariance[row, column] = value

    return _with_covariance(change)


def _moved(pose: Pose) -> Bad:
    return _changed(lambda _, good: replace(good, pose=pose @ good.pose))


def _stamped(seconds: float) -> Bad:
    return _changed(lambda d, good: replace(good, stamp_ns=d.now_ns + to_ns(seconds)))


def _repeated(drive: Drive) -> Approved | Refused:
    good = drive.good()
    drive.judge(good)
    return drive.judge(good)


KINDS: dict[str, Bad] = {
    "jump of 6 sigmas or more": lambda drive: drive.judge(drive.jump(6.0)),
    "another frame": _changed(lambda _, good: replace(good, frame_id="odom")),
    "lifted": _moved(Pose(np.eye(3), np.array([0, 0, 0.01]))),
    "tilted": _moved(Pose.from_vector([0, 0, 0, 0.01, 0, 0])),
    "not finite": _moved(Pose(np.eye(3), np.array([np.nan, 0, 0]))),
    "1e300 away": _moved(Pose(np.eye(3), np.array([1e300, 0, 0]))),
    "another robot's": _moved(Pose.planar(2.0, -3.0, 1.0)),
    "variance zero": _set(0, 0, 0.0),
    "variance negative": _set(1, 1, -1e-4),
    "variance 1e-200": _set(0, 0, 1e-200),
    "variance 1e-11": _set(5, 5, 1e-11),
    "variance infinite": _set(0, 0, np.inf),
    "variance not a number": _set(5, 5, np.nan),
    "upper triangle not positive": _set(0, 1, 0.2),
    "lower triangle only": _set(1, 0, 2e-5),
    "sigma 0.3 m": _set(0, 0, 0.09),
    "sigma 0.3 rad": _set(5, 5, 0.09),
    "1.1 s old": _stamped(-1.1),
    "0.2 s ahead": _stamped(0.2),
    "after the newest reading": _stamped(0.01),
    "repeated": _repeated,
    "of another map": lambda drive: drive.judge(drive.good(), map_id=OTHER_MAP),
}


def judged(good: int, bad: int, memory_s: float) -> tuple[Counter[str], Counter[str]]:
    """Of the good ones those refused, by the reason; of the bad ones those approved, by kind."""
    names, done, each = list(KINDS), 0, good // _DRIVES
    refused, approved = Counter[str](), Counter[str]()
    for number in range(_DRIVES):
        drive = Drive(1000 + number, memory_s, SIGMAS[number % len(SIGMAS)])
        drive.place()
        for k in range(each):
            for _ in range(EVERY):
                drive.advance()
            verdict = drive.judge(drive.good())
            if isinstance(verdict, Refused):
                refused[verdict.reason] += 1
            while done * good < bad * (number * each + k + 1):
                kind = names[done % len(names)]
                drive.advance()
                if isinstance(KINDS[kind](drive), Approved):
                    approved[kind] += 1
                done += 1
    return refused, approved


@pytest.mark.parametrize("memory_s", [0.0, 5.0])
@pytest.mark.parametrize(
    ("good", "bad"),
    [
        (400, 3 * len(KINDS)),
        pytest.param(100_000, 10_000, marks=[pytest.mark.long, pytest.mark.timeout(7200)]),
    ],
)
def test_every_true_correction_is_approved_and_no_bad_one(
    good: int, bad: int, memory_s: float
) -> None:
    assert judged(good, bad, memory_s) == (Counter(), Counter())
