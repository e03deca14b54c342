"""Given lenses that the pictures contradict.

A lens that is not the camera's bends the map so that its pictures fit about: they are said to be
noisy, and cameras are sure of wrong places. So a solution is asked whether another lens would fit
better than chance allows: its equations, with a lens to be estimated for each camera, say by how
much χ² would fall if that were free (score test: Rao, 1948). What else a file may have wrong is
free, too: odometry that is longer than it is told, faces that are mounted otherwise.
"""

from collections import defaultdict

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.association.events import EVIDENCE
from trigpoint.fusion.model.assembly import lens_sigmas
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import Priors, Problem, State, layout_of
from trigpoint.fusion.solver.equations import Reduced
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array

# The χ² of a pose (6,) that its covariance allows with one in a hundred.
_BEYOND = chi2_limit(6, 1e-2)
# Prior sigmas of what a site file takes as known: odometry's scales, and faces' mounting (m, rad).
_SCALE_SIGMA, _MOUNT_SIGMA = 0.1, 0.02
# Of a lens's parameters.
_WHOLE, _FOCAL, _CENTRE, _DISTORTION = slice(None), slice(2), slice(2, 4), slice(4, None)
_PARTS = _FOCAL, _CENTRE, _DISTORTION


class UnfitLens(Struct, frozen=True):
    """What of a lens the pictures contradict, in `words`, and whether it is the cause that a camera
    is farther from its place than its sigma says (`is_harmful`)."""

    words: str
    is_harmful: bool


def unfit_lenses(
    data: DataSet, problem: Problem, state: State, reduced: Reduced, scale: float
) -> dict[str, UnfitLens]:
    """Camera -> what its pictures have against the lens that is given. `reduced`: of the problem at
    `state`, its minimum; `scale`: χ² per degree of freedom there, by which all else is off. Raises
    LinAlgError where an unknown is not determined."""
    seen = {problem.priors.owners[batch.camera] for batch in problem.batches}
    given = [name for name in problem.layout.pose if name in seen - problem.priors.lens.keys()]
    if not given:
        return {}
    problem = _freed(data, problem, state, given)
    change = _Change(linearise(problem, state).reduced(), problem.priors, max(1.0, scale))
    limit, found = EVIDENCE / len(given), dict[str, str]()
    for names in _by_model(state, given):
        each = {name: change.chi2([name]) for name in names}
        beyond = chi2_limit(len(change.layout.lens[names[0]]), limit)
        if change.chi2(names) > max(beyond, *each.values()):  # the fault is common to all
            found |= dict.fromkeys(names, change.words(names))
        else:
            found |= {name: change.words([name]) for name in names if each[name] > beyond}
    harm = bool(found) and _is_harmful(data, change.shifts(list(found)), reduced)
    return {data.site_camera(name): UnfitLens(words, harm) for name, words in found.items()}


def _by_model(state: State, cameras: list[str]) -> list[list[str]]:
    """The cameras with each kind of lens, whose files may have one fault."""
    found = defaultdict[LensModel, list[str]](list)
    for name in cameras:
        found[state.cameras[name].lens.model].append(name)
    return list(found.values())


class _Change:
    """What would change of all unknowns if lenses were free; a χ² by so many times smaller as all
    else is off, the `scale`."""

    def __init__(self, freed: Reduced, priors: Priors, scale: float) -> None:
        self.layout, self._lenses, self._scale = freed.layout, priors.lens, scale
        self._covariance = freed.covariance()
        self._step = -self._covariance @ freed.gradient

    def chi2(self, cameras: list[str], part: slice = _WHOLE) -> float:
        """By how much χ² falls if this part of the cameras' lenses changes, of all alike."""
        step, information = self._alike(cameras, part)
        return float(step @ information @ step) / self._scale

    def words(self, cameras: list[str]) -> str:
        """What of the cameras' lenses changes most."""
        part = max(_PARTS, key=lambda part: self.chi2(cameras, part))
        (first, sigmas), (step, _) = self._lenses[cameras[0]], self._alike(cameras, _WHOLE)
        step = step[part] * sigmas[part]
        if part == _FOCAL:
            ratio = float(np.mean(step / first[part]))
            side = "longer" if ratio > 0 else "shorter"
            return f"a focal length about {100 * abs(ratio):.2g} % {side} fits"
        if part == _CENTRE:
            return f"a principal point about {np.hypot(*step):.2g} px off fits"
        return "other distortion coefficients fit"

    def shifts(self, cameras: list[str]) -> dict[str, Array]:
        """By how much each camera's pose (6,) is off because of these cameras' lenses."""
        rows = np.concatenate([self.layout.lens[name] for name in cameras])
        pull = np.linalg.solve(self._covariance[np.ix_(rows, rows)], self._step[rows])
        poses = self.layout.pose.items()
        return {name: self._covariance[np.ix_(mine, rows)] @ pull for name, mine in poses}

    def _alike(self, cameras: list[str], part: slice) -> tuple[Array, Array]:
        """The common step (k,) of a part of lenses, in the priors' sigmas, and its information."""
        rows = np.concatenate([self.layout.lens[name][part] for name in cameras])
        units = np.concatenate([np.diag(self._lenses[name][1][part]) for name in cameras])
        pull = np.linalg.solve(self._covariance[np.ix_(rows, rows)], units)
        information = units.T @ pull
        return np.linalg.solve(information, pull.T @ self._step[rows]), information


def _is_harmful(data: DataSet, shifts: dict[str, Array], stated: Reduced) -> bool:
    """Whether a camera is farther off than its covariance allows, by these shifts (6,)."""
    covariance, columns = stated.covariance(), stated.layout.pose
    return any(
        shift @ np.linalg.solve(covariance[np.ix_(columns[name], columns[name])], shift) > _BEYOND
        for name, shift in shifts.items()
        if name in data.site.cameras
    )


def _freed(data: DataSet, problem: Problem, state: State, cameras: list[str]) -> Problem:
    """The problem with lenses of these cameras, and the robots' scales and faces, as unknowns."""
    priors, lenses = problem.priors, dict(problem.priors.lens)
    for name in cameras:
        lens = state.cameras[name].lens
        config = data.site.cameras[data.site_camera(name)]
        lenses[name] = lens.parameters, lens_sigmas(config, lens)
    scales = {robot: np.full(2, _SCALE_SIGMA) for robot in problem.chains}
    faces = {
        robot: (state.robots[robot].base_from_face, _MOUNT_SIGMA, _MOUNT_SIGMA)
        for robot in problem.chains
    }
    scales, faces = scales | priors.scales, faces | priors.faces
    priors = replace(priors, lens=lenses, scales=scales, faces=faces)
    layout = layout_of(list(problem.layout.pose), problem.chains, priors, state)
    return replace(problem, priors=priors, layout=layout)
