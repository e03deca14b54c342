"""The state of a recursive filter at a moment; immutable, so that going back costs nothing."""

from typing import Protocol, Self

from msgspec import Struct

from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import is_noise
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

from .relative_pose import RelativeView, relative_view


class ReadSighting(Struct, frozen=True):
    """An observation prepared for a filter: read, its outlier corners marked, and the approximate
    pose of the robot by it, `map_from_base`.

    `variances` (6,): of the robot's deviation in this picture from its pose by odometry, None where
    there is no deviation; `places_robot`: the robot's pose is not known otherwise.
    """

    observation: Observation
    map_from_base: Pose
    variances: Array | None = None
    places_robot: bool = False

    def view(self, data: DataSet, lens: CameraModel, camera_from_base: Pose) -> RelativeView | None:
        """The sighting linearised at a pose; None where it is of no use there."""
        target = data.targets[self.observation.robot]
        return relative_view(self.observation, target, lens, camera_from_base, self.variances)


class Innovation(Struct, frozen=True):
    """How far an observation was from its prediction.

    `chi2`, `freedom`: of the innovation, with its degrees of freedom; `total`, `total_freedom`:
    with what no pose explains; `rms_px`: the residual's RMS of a coordinate after the update.
    """

    chi2: float
    freedom: int
    total: float
    total_freedom: int
    rms_px: float

    @property
    def is_expected(self) -> bool:
        """Whether it passes the χ² gate (normalised innovation squared)."""
        return self.freedom == 0 or is_noise(self.chi2, self.freedom)


class FilterState(Protocol):
    """Robots at their last nodes and the located cameras, with their joint uncertainty."""

    @property
    def stamps_ns(self) -> dict[str, int]:
        """The stamp of the last node of each robot that is located in the map."""
        ...

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras that are part of the state."""
        ...

    def camera(self, camera: str) -> CameraState: ...

    def estimate(self, camera: str) -> CameraEstimate: ...

    def robot(self, robot: str) -> RobotEstimate:
        """The robot at its last node."""
        ...

    def scales(self, robot: str) -> Array:
        """The robot's odometry scale errors, (2,)."""
        ...

    def advanced(self, data: DataSet, robot: str, stamp_ns: int) -> Self:
        """The robot moved on to a later time by its odometry."""
        ...

    def updated(self, data: DataSet, sighting: ReadSighting) -> tuple[Self, Innovation] | None:
        """The state after a sighting of the robot at its last node, or one that locates it, by a
        camera that is part of the state; None where the sighting is of no use."""
        ...

    def with_camera(
        self, data: DataSet, sighting: ReadSighting, camera: CameraState
    ) -> tuple[Self, Innovation] | None:
        """The state with a new camera, by its first sighting; `camera`: its approximate state.
        None where the sighting does not determine its pose."""
        ...

    def without_robot(self, robot: str) -> Self: ...

    def spread(self, covariances: dict[str, Array]) -> Self:
        """The state with these covariances (6, 6) added to those of cameras' poses."""
        ...

    def joint_covariance(self, cameras: list[str]) -> Array:
        """(6n, 6n) over the poses of these cameras."""
        ...

    def particles(self, robot: str) -> Pose | None:
        """Samples of the robot's pose, all equally likely; None for a filter without samples."""
        ...
