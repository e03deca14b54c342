"""What every estimator offers to the pipeline."""

from typing import NamedTuple, Protocol

import numpy as np
from msgspec import Struct

from trigpoint.fusion.association.explanation import Alternative
from trigpoint.fusion.model.dataset import CameraMove
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.fusion.solver.snapshot import GuidanceWorld
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

from .residuals import CameraResiduals
from .unfit_inputs import UnfitInputs


class CameraEstimate(Struct, frozen=True):
    """A camera in the map; `covariance`: (6, 6); `lens_sigma`: of `lens.parameters`."""

    map_from_camera: Pose
    covariance: Array
    lens: CameraModel
    lens_sigma: Array
    time_offset_s: float
    time_offset_sigma_s: float


class CameraCount(Struct, frozen=True):
    """Counts of a camera's sightings (faces, not pictures). `rejected`: those that the estimate of
    a located camera does not use; `reprojection_rms`: of a coordinate, pixels."""

    sightings: int
    rejected: int
    reprojection_rms: float | None

    @property
    def is_confirmed(self) -> bool:
        """Whether a located camera rests on more than one sighting."""
        return self.sightings - self.rejected > 1


class Update(Struct, frozen=True):
    """The effect of an observation: `correction`, where it was one of a camera located before;
    `problem`: why it could not be used at all, "" where it could; `contradiction`: what it says
    against a map that does not change, "" where that may be chance; None: it does not."""

    correction: RobotEstimate | None = None
    located: tuple[str, ...] = ()
    problem: str = ""
    contradiction: str | None = None


class Trajectory(NamedTuple):
    """A robot's trajectory: `map_from_base` (n) at each odometry message's stamp (n,)."""

    stamps_ns: np.ndarray
    map_from_base: Pose


class Live(Protocol):
    """Odometry and observations in, the robots' and the cameras' poses out. Not thread-safe. What
    an estimator does not work out is None, as it is here."""

    def add_odometry(self, robot: str, readings: Readings) -> list[int]:
        """Take a robot's odometry, one message after the other; what became of each, `Added`."""
        ...

    def add_observation(self, observation: Observation) -> Update:
        """Take an observation whose moment odometry covers, in any order. One that repeats others
        makes a correction, and nothing is learnt from it."""
        ...

    def collect(self, observation: Observation) -> None:
        """Take an observation for `finish` alone, where live results are not needed."""
        ...

    def camera_moved(self, move: CameraMove) -> None:
        """Take that a camera noticed itself that it was moved: what it sees from then on makes no
        correction, and spoils nothing, until sightings show where it is."""
        ...

    def leave_open(self, cameras: frozenset[str]) -> None:
        """Locate none of these cameras: pictures of theirs were left out undecided, which may show
        that they were moved."""
        ...

    def finish(self) -> None:
        """Explain all that came in, and solve to convergence."""
        ...

    def robot(self, robot: str) -> RobotEstimate | None:
        """The robot at its last odometry message; None while it is not located in the map."""
        ...

    def particles(self, robot: str) -> Pose | None:  # noqa: ARG002
        """Samples of the robot's pose at its last odometry message, all equally likely; None where
        the estimator has none."""
        return None

    def trajectory(self, robot: str) -> Trajectory | None:  # noqa: ARG002
        """The robot's trajectory from its first message; None where that is not known."""
        return None

    def cameras(self) -> dict[str, CameraEstimate]:
        """The located cameras."""
        ...

    @property
    def located_count(self) -> int:
        """How many cameras are located."""
        ...

    def guidance_world(self) -> GuidanceWorld | None:
        """A copy of what is known for guidance to work on; None where there is too little yet, or
        the estimator does not solve for all poses of the robot at once."""
        return None

    def residuals(self, camera: str) -> CameraResiduals | None:  # noqa: ARG002
        """The residuals of a camera's corners at the last solution; None where the estimator does
        not solve for all poses of the robot at once."""
        return None

    def unfit_inputs(self) -> UnfitInputs:
        """What was given, and what was seen contradicts, at the last solution."""
        return UnfitInputs()


class Estimator(Live, Protocol):
    """A `Live` estimator with the further contents of the network file."""

    def joint_covariance(self) -> Array:
        """(6n, 6n) over the poses of the located cameras, in their order."""
        ...

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        """Cameras that saw a robot but could not be located: what is not known of them."""
        ...

    def alternatives(self, camera: str) -> tuple[Alternative, ...]:
        """The possible poses of a camera that is not located, best first."""
        ...

    def count(self, camera: str) -> CameraCount: ...

    def scales(self, robot: str) -> Array:
        """The robot's odometry scale errors of distance and heading, (2,)."""
        ...

    def base_from_faces(self, robot: str) -> Pose: ...

    @property
    def chi2_per_dof(self) -> float | None: ...

    @property
    def iterations(self) -> int: ...
