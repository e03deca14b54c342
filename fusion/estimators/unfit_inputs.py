"""Given lenses, and scales of odometry, that the pictures contradict.

A lens that is not the camera's bends the map so that its pictures fit about, as odometry does that
is longer than it is told: pictures or odometry are said to be noisy, and cameras are sure of wrong
places. So a solution is asked whether others would fit better than chance allows: its equations,
with a lens to be estimated for each camera and scales for each robot, say by how much χ² would fall
if one were free (score test: Rao, 1948). Faces that are mounted otherwise are free, too.
"""

from collections import defaultdict

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.association.events import EVIDENCE
from trigpoint.fusion.association.explanation import are_little
from trigpoint.fusion.association.other_odometry import other_lengths, other_turns
from trigpoint.fusion.model.assembly import lens_sigmas
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import Priors, Problem, State, layout_of
from trigpoint.fusion.solver.equations import Reduced
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array

# The χ² of a pose (6,) that its covariance allows with one in a hundred.
_BEYOND = chi2_limit(6, 1e-2)
# Prior sigmas of what a site file takes as known: odometry's scales, and faces' mounting (m, rad).
_SCALE_SIGMA, _MOUNT_SIGMA = 0.1, 0.02
# A scale beyond is not told by one linear step, but to be so far off at least.
_LINEAR = 0.3
# Of a lens's parameters.
_WHOLE, _FOCAL, _CENTRE, _DISTORTION = slice(None), slice(2), slice(2, 4), slice(4, None)
_PARTS = _FOCAL, _CENTRE, _DISTORTION
# Of a robot's scales: distance and heading.
_SCALES = (slice(1), other_lengths), (slice(1, 2), other_turns)


class Unfit(Struct, frozen=True):
    """What fits of what was given, in `words`, and whether it is the cause that a camera is farther
    from its place than its sigma says (`is_harmful`), and by more than is little (`is_far`)."""

    words: str
    is_harmful: bool
    is_far: bool


class UnfitInputs(Struct, frozen=True):
    """`lenses`: camera -> what fits its pictures in place of the lens that is given; `scales`:
    robot -> how its odometry tells ways, or turns."""

    lenses: dict[str, Unfit] = {}
    scales: dict[str, Unfit] = {}

    def with_lenses(self, data: DataSet, lenses: dict[str, CameraModel]) -> "UnfitInputs":
        """The same where cameras' pictures are known to fit these lenses far better."""
        found = dict[str, Unfit]()
        for name, lens in lenses.items():
            given = data.lenses[name]
            step = lens.parameters - given.parameters
            far = np.abs(step / lens_sigmas(data.site.cameras[name], given))
            part = max(_PARTS, key=lambda part: far[part].max(initial=0.0))
            words = _words(part, given.parameters, step)
            found[name] = Unfit(words, is_harmful=True, is_far=True)
        return replace(self, lenses=found | self.lenses)


def unfit_inputs(
    data: DataSet, problem: Problem, state: State, reduced: Reduced, scale: float
) -> UnfitInputs:
    """What was given and does not fit. `reduced`: of the problem at `state`, its minimum; `scale`:
    χ² per degree of freedom there, by which all else is off. Raises LinAlgError where an unknown is
    not determined."""
    seen = {problem.priors.owners[batch.camera] for batch in problem.batches}
    given = [name for name in problem.layout.pose if name in seen - problem.priors.lens.keys()]
    problem = _freed(data, problem, state, given)
    change = _Change(linearise(problem, state).reduced(), problem.priors, max(1.0, scale))
    lenses, scales = _lenses(change, state, given), dict[str, Unfit]()
    harm = _harm(data, change.shifts(list(lenses)), reduced) if lenses else (False, False)
    for robot in problem.chains:
        part, words = max(_SCALES, key=lambda each: change.chi2([robot], each[0]))
        if change.chi2([robot], part) > chi2_limit(1, EVIDENCE / len(problem.chains) / 2):
            longer = state.robots[robot].scales + change.step([robot])
            by = 1 / (1 + np.clip(longer, -_LINEAR, _LINEAR))
            beside = _harm(data, change.shifts([robot], part), reduced)
            scales[robot] = Unfit(words(float(by[part][0])), *beside)
    return UnfitInputs(
        {data.site_camera(name): Unfit(words, *harm) for name, words in lenses.items()}, scales
    )


def _lenses(change: "_Change", state: State, given: list[str]) -> dict[str, str]:
    """Camera -> what of its lens does not fit, in words."""
    limit, found = EVIDENCE / max(1, len(given)), dict[str, str]()
    for names in _by_model(state, given):
        each = {name: change.chi2([name]) for name in names}
        beyond = chi2_limit(len(change.columns[names[0]]), limit)
        if change.chi2(names) > max(beyond, *each.values()):  # the fault is common to all
            found |= dict.fromkeys(names, change.words(names))
        else:
            found |= {name: change.words([name]) for name in names if each[name] > beyond}
    return found


def _by_model(state: State, cameras: list[str]) -> list[list[str]]:
    """The cameras with each kind of lens, whose files may have one fault."""
    found = defaultdict[LensModel, list[str]](list)
    for name in cameras:
        found[state.cameras[name].lens.model].append(name)
    return list(found.values())


class _Change:
    """What would change of all unknowns if lenses, or scales, were free; a χ² by so many times
    smaller as all else is off, the `scale`. `columns`: of each camera's lens and robot's scales."""

    def __init__(self, freed: Reduced, priors: Priors, scale: float) -> None:
        self._poses, self._lenses, self._scale = freed.layout.pose, priors.lens, scale
        self.columns = freed.layout.lens | freed.layout.scales
        self._units = {name: sigmas for name, (_, sigmas) in priors.lens.items()}
        self._units |= dict.fromkeys(priors.scales, np.full(2, _SCALE_SIGMA))
        self._covariance = freed.covariance()
        self._step = -self._covariance @ freed.gradient

    def chi2(self, names: list[str], part: slice = _WHOLE) -> float:
        """By how much χ² falls if this part of lenses, or scales, changes, of all alike."""
        step, information = self._alike(names, part)
        return float(step @ information @ step) / self._scale

    def step(self, names: list[str]) -> Array:
        """By how much lenses, or scales, change, all alike (k,)."""
        return self._alike(names, _WHOLE)[0] * self._units[names[0]]

    def words(self, cameras: list[str]) -> str:
        """What of the cameras' lenses changes most."""
        part = max(_PARTS, key=lambda part: self.chi2(cameras, part))
        return _words(part, self._lenses[cameras[0]][0], self.step(cameras))

    def shifts(self, names: list[str], part: slice = _WHOLE) -> dict[str, Array]:
        """By how much each camera's pose (6,) is off because of this part of lenses, or scales."""
        rows = np.concatenate([self.columns[name][part] for name in names])
        pull = np.linalg.solve(self._covariance[np.ix_(rows, rows)], self._step[rows])
        poses = self._poses.items()
        return {name: self._covariance[np.ix_(mine, rows)] @ pull for name, mine in poses}

    def _alike(self, names: list[str], part: slice) -> tuple[Array, Array]:
        """The common step (k,) of a part of lenses, or scales, in units, and its information."""
        rows = np.concatenate([self.columns[name][part] for name in names])
        units = np.concatenate([np.diag(self._units[name][part]) for name in names])
        pull = np.linalg.solve(self._covariance[np.ix_(rows, rows)], units)
        information = units.T @ pull
        return np.linalg.solve(information, pull.T @ self._step[rows]), information


def _words(part: slice, given: Array, step: Array) -> str:
    """What a step of a lens's parameters means, of a part of them."""
    if part == _FOCAL:
        ratio = float(np.mean(step[part] / given[part]))
        side = "longer" if ratio > 0 else "shorter"
        return f"a focal length about {100 * abs(ratio):.2g} % {side} fits"
    if part == _CENTRE:
        return f"a principal point about {np.hypot(*step[part]):.0f} px off fits"
    return "other distortion coefficients fit"


def _harm(data: DataSet, shifts: dict[str, Array], stated: Reduced) -> tuple[bool, bool]:
    """Whether a camera is farther off than its covariance allows, by these shifts (6,), and one
    that is by more than is little."""
    covariance, columns = stated.covariance(), stated.layout.pose
    beyond = [
        shift
        for name, shift in shifts.items()
        if name in data.site.cameras
        and shift @ np.linalg.solve(covariance[np.ix_(columns[name], columns[name])], shift)
        > _BEYOND
    ]
    return bool(beyond), not all(are_little(shift) for shift in beyond)


def _freed(data: DataSet, problem: Problem, state: State, cameras: list[str]) -> Problem:
    """The problem with lenses of these cameras, and the robots' scales and faces, as unknowns."""
    priors, lenses = problem.priors, dict(problem.priors.lens)
    for name in cameras:
        lens = state.cameras[name].lens
        config = data.site.cameras[data.site_camera(name)]
        lenses[name] = lens.parameters, lens_sigmas(config, lens)
    scales = {
        robot: np.maximum(_SCALE_SIGMA, priors.scales.get(robot, np.zeros(2)))
        for robot in problem.chains
    }
    faces = {
        robot: (state.robots[robot].base_from_face, _MOUNT_SIGMA, _MOUNT_SIGMA)
        for robot in problem.chains
    }
    faces |= priors.faces
    priors = replace(priors, lens=lenses, scales=scales, faces=faces)
    layout = layout_of(list(problem.layout.pose), problem.chains, priors, state)
    return replace(problem, priors=priors, layout=layout)
