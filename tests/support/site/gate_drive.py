"""A robot that drives, a fusion that knows where it is, and the gate between them."""

from collections.abc import Callable
from uuid import UUID

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract.correction import CorrectionMark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.geometry import Pose
from trigpoint.robot.gate.safety import Approved, Refusal, Refused, SafetyGate
from trigpoint.robot.odometry.odometry import Stamped
from trigpoint.site.config import OdometryNoise, RobotConfig

MAP, OTHER_MAP = UUID(int=1), UUID(int=2)
MAP_FROM_ODOM = Pose.planar(10.0, 5.0, 1.0)
SIGMA, HEADING_SIGMA = 0.01, 0.01
BEGIN_NS = to_ns(1000.0)
SPEED = 0.4


class Site:
    """The robot drives 0.4 m/s along x of its odometry; `fusion_map`: what fusion says its map is,
    which is asked before each correction as the node does."""

    def __init__(self, noise: OdometryNoise | None = None, *, planar: bool = True) -> None:
        self.config = RobotConfig(port="x", odometry=noise or OdometryNoise(), planar=planar)
        self.gate = SafetyGate(self.config)
        self.now_ns, self.sequence = BEGIN_NS, 0
        self.fusion_map: UUID | None = MAP
        self.path: Callable[[float], Pose] = lambda t_s: Pose.planar(SPEED * t_s, 0.0, 0.0)
        self.drive(0.5)

    def odom_from_base(self, stamp_ns: int) -> Pose:
        return self.path((stamp_ns - BEGIN_NS) / 1e9)

    def drive(self, seconds: float) -> None:
        end_ns = self.now_ns + to_ns(seconds)
        while self.now_ns < end_ns:
            self.now_ns += to_ns(0.02)
            pose = self.odom_from_base(self.now_ns)
            self.gate.add_odometry(Stamped(self.now_ns, self.now_ns - to_ns(900.0), pose))

    def truth(self, age_s: float = 0.1) -> PoseEstimate:
        """A true correction of some time ago."""
        stamp_ns = self.now_ns - to_ns(age_s)
        pose = MAP_FROM_ODOM @ self.odom_from_base(stamp_ns)
        covariance = np.diag([SIGMA**2, SIGMA**2, 0, 0, 0, HEADING_SIGMA**2])
        if not self.config.planar:
            covariance = np.eye(6) * SIGMA**2
        return PoseEstimate(stamp_ns, "map", pose, covariance)

    def judge(
        self, correction: PoseEstimate, map_id: UUID = MAP, sender: str = "fusion"
    ) -> Approved | Refused:
        self.sequence += 1
        if self.gate.asks:
            known = [] if self.fusion_map is None else [self.fusion_map]
            self.gate.hear(known, self.now_ns)
        mark = CorrectionMark(map_id, self.sequence)
        return self.gate.judge(correction, mark, self.now_ns, sender)

    def correct(
        self,
        off: Pose | None = None,
        *,
        age_s: float = 0.1,
        sigma: float = SIGMA,
        heading_sigma: float = HEADING_SIGMA,
        map_id: UUID = MAP,
        sender: str = "fusion",
        frame: str = "map",
        covariance: np.ndarray | None = None,
    ) -> Approved | Refused:
        """Judge a correction that is off the truth by `off` in the map's axes."""
        correction = self.truth(age_s)
        pose = correction.pose
        if off is not None:
            pose = Pose(off.rotation @ pose.rotation, off.translation + pose.translation)
        if covariance is None:
            covariance = np.diag([sigma**2, sigma**2, 0, 0, 0, heading_sigma**2])
        correction = replace(correction, frame_id=frame, pose=pose, covariance=covariance)
        return self.judge(correction, map_id, sender)

    def place(self) -> Approved:
        """Drive until true corrections have placed the robot."""
        verdict: Approved | Refused | None = None
        for _ in range(40):
            self.drive(0.1)
            verdict = self.judge(self.truth())
            if isinstance(verdict, Approved):
                assert verdict.establishes
                self.drive(0.1)
                return verdict
        raise AssertionError(f"not placed: {verdict}")


def placed(noise: OdometryNoise | None = None, *, planar: bool = True) -> Site:
    """A site whose robot knows where it is."""
    site = Site(noise, planar=planar)
    site.place()
    return site


def reason(verdict: Approved | Refused) -> Refusal | None:
    return verdict.reason if isinstance(verdict, Refused) else None


def off_by(verdict: Approved | Refused, site: Site, age_s: float = 0.1) -> float:
    """How far what the robot is told lies from the truth, metres."""
    assert isinstance(verdict, Approved)
    true = MAP_FROM_ODOM @ site.odom_from_base(site.now_ns - to_ns(age_s))
    return float(np.linalg.norm(verdict.map_from_base.difference(true)[:2]))
