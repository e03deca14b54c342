"""The residuals of corners at a solution: of one camera, and the χ² of them all."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.prediction import batch_residual
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.fusion.solver.levenberg_marquardt import Solution
from trigpoint.geometry.rotation import Array


class CameraResiduals(Struct, frozen=True, eq=False):
    """One camera's corners in its used observations, at all poses that it had.

    `places` (m, 3): where the robots stood in all of its observations, as far as that is known.
    `pixels` (n, 2): where they were seen; `residual_px` (n, 2): predicted minus seen; `sigma_px`
    (n,): of a coordinate, as the detector stated it; `used` (n,) bool: False for outliers, which
    were left out.
    """

    places: Array
    pixels: Array
    residual_px: Array
    sigma_px: Array
    used: np.ndarray

    @property
    def in_sigmas(self) -> Array:
        """The residuals (m, 2) of the used corners, in sigmas."""
        return (self.residual_px / self.sigma_px[:, None])[self.used]


def camera_residuals(
    data: DataSet, problem: Problem | None, state: State, camera: str
) -> CameraResiduals:
    """The residuals at a solution; `problem` None: nothing was solved yet."""
    names = data.places_of(camera)
    batches = [b for b in problem.batches if b.camera in names] if problem is not None else []
    parts = [_corners(data, batch, state) for batch in batches]
    entries = [entry for name in names for entry in data.of_camera(name)]
    joined = [np.concatenate(part) for part in zip(*parts, strict=True)] if parts else _none()
    return CameraResiduals(_places(entries), *joined)


def _places(entries: list[Entry]) -> Array:
    poses = [entry.map_from_base for entry in entries]
    return np.array([pose.translation for pose in poses if pose is not None]).reshape(-1, 3)


def _corners(data: DataSet, batch: Batch, state: State) -> tuple[Array, Array, Array, np.ndarray]:
    """Pixels, residuals, sigmas and use of all corners in a batch, in one row."""
    sigmas = np.ones(batch.weights.shape)
    real = np.zeros(batch.weights.shape, dtype=bool)
    for row, source in enumerate(batch.sources.tolist()):
        mine = data.entries[source].observation.sigmas
        sigmas[row, : len(mine)], real[row, : len(mine)] = mine, True
    # With every weight at 1 outliers have a residual too, and all are in pixels.
    residual = batch_residual(replace(batch, weights=real.astype(float)), state)
    return batch.pixels[real], residual[real], sigmas[real], (batch.weights > 0)[real]


def _none() -> list[np.ndarray]:
    return [np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool)]


def reprojection_rms_px(problem: Problem, state: State, camera: str) -> float | None:
    """RMS of a coordinate over a camera's used corners, pixels."""
    total, count = 0.0, 0
    for batch in problem.batches:
        if batch.camera == camera:
            residual = batch_residual(batch, state)
            used = batch.weights > 0
            total += float(np.sum((residual[used] / batch.weights[used][:, None]) ** 2))
            count += 2 * int(used.sum())
    return float(np.sqrt(total / count)) if count else None


def chi2_per_dof(problem: Problem, solution: Solution) -> float | None:
    """Cost over its degrees of freedom: 1 where the noise is as stated, or as the session tells."""
    corners = sum(
        float(((batch.weights > 0) * batch.shares[:, None]).sum()) for batch in problem.batches
    )
    odometry = sum(
        len(chain.tangent) * (len(chain) - 1)
        for chain in problem.chains.values()
        if chain.motion is not None
    )
    nodes = sum(
        len(chain.tangent) * (len(chain) - int(chain.is_anchored))
        for chain in problem.chains.values()
    )
    last = sum(len(columns) for columns in problem.layout.last.values())
    priors = problem.layout.size - last - 6 * len(problem.layout.pose)
    priors += 6 * len(problem.priors.known.poses)
    unknowns = nodes + problem.layout.size - last
    freedom = 2 * corners + odometry + priors - unknowns
    return solution.cost / freedom if freedom > 0 else None
