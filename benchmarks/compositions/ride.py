"""A robot's true way and what its odometry reports of it, leg by leg.

Every leg is driven as reported and the truth scatters about the report, by the letter of the
contract; the next leg starts from where the robot truly is, as if somebody watched it.
"""

import numpy as np
from msgspec import Struct, structs
from msgspec.structs import replace

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import wrap
from trigpoint.site.config import OdometryNoise
from trigpoint.tools.simulation.motion.odometry import (
    chained,
    chained_in_space,
    scattered,
    scattered_in_space,
)

from .recipe import Recipe

STEP_S = 0.01  # true poses; pictures are taken at them
STEPS_A_MESSAGE = 5  # 20 Hz
_SPEED_M_S, _TURN_RAD_S = 0.4, 0.9
_SLIP_S, _SLIPS_A_SECOND = 0.5, 0.1
# What scatters by a random walk; in space also as the defaults are in the plane.
_SCATTERS = (
    "distance",
    "lateral",
    "heading_drive",
    "heading_turn",
    "vertical",
    "tilt",
    "tilt_turn",
)
_IN_SPACE = dict.fromkeys(("vertical", "tilt", "tilt_turn"), 0.003)
# How far a robot in space is held beside its level way, m and rad.
_MOST_SWING = np.array([0.03, 0.03, 0.15, 0.15, 0.15, 0.1])


class Ride(Struct, frozen=True, eq=False):
    """`map_from_base`, `odom_from_base`: (n) poses, one each STEP_S, from time 0 on; `stops_s`:
    the middle of each stand; `straight_s`: from when to when it drove straight; `lifts_s`;
    `scale_errors`: (2,) of distance and heading."""

    map_from_base: Pose
    odom_from_base: Pose
    stops_s: list[float]
    straight_s: list[tuple[float, float]]
    lifts_s: list[float]
    scale_errors: np.ndarray
    is_in_space: bool = False

    @property
    def end_s(self) -> float:
        """The time of the last pose."""
        return (len(self.map_from_base) - 1) * STEP_S

    def at(self, times_s: np.ndarray) -> Pose:
        """True poses at times (n,) that lie on the steps; it stands at its end afterwards."""
        index = np.round(np.asarray(times_s) / STEP_S).astype(int)
        return self.map_from_base[np.clip(index, 0, len(self.map_from_base) - 1)]

    def lasting(self, end_s: float) -> "Ride":
        """The same, standing at its end until then, which is not before that."""
        last = len(self.map_from_base) - 1
        kept = np.minimum(np.arange(round(end_s / STEP_S) + 1), last)
        true, reported = self.map_from_base[kept], self.odom_from_base[kept]
        return replace(self, map_from_base=true, odom_from_base=reported)


class Driver:
    """Drives a robot and keeps what happened."""

    def __init__(
        self, recipe: Recipe, robot: str, start: np.ndarray, *, odometry_start: np.ndarray
    ) -> None:
        """`start`, `odometry_start`: (3,) x, y, heading in the map and as reported."""
        self._random = recipe.random("wheels", robot)
        self._noise = true_noise(recipe)
        self._slip = recipe.slip
        self._swing = Swing(self._random) if recipe.in_space else None
        self.scale_errors = self._random.standard_normal(2) * recipe.scale
        self._truth = [Pose.stack([Pose.planar(*start)])]
        self._report = [Pose.stack([Pose.planar(*odometry_start)])]
        self._steps = 0
        self._stops_s: list[float] = []
        self._straight_s: list[tuple[float, float]] = []
        self._lifts_s: list[float] = []

    @property
    def here(self) -> np.ndarray:
        """Where it truly is: (3,) x, y, heading."""
        pose = self._truth[-1][-1]
        return np.array([*pose.translation[:2], pose.heading])

    @property
    def now_s(self) -> float:
        return self._steps * STEP_S

    def turn_to(self, heading_rad: float) -> None:
        """Turn on the spot."""
        self.turn_by(float(wrap(heading_rad - self.here[2])))

    def turn_by(self, turn_rad: float) -> None:
        """Turn on the spot, also by more than a half turn."""
        self._leg(0.0, turn_rad, abs(turn_rad) / _TURN_RAD_S)

    def go_to(self, place: np.ndarray) -> None:
        """Turn to a place (2,) and drive there in a straight line."""
        way = place - self.here[:2]
        if (length := float(np.hypot(*way))) < 0.02:
            return
        self.turn_to(float(np.arctan2(way[1], way[0])))
        began_s = self.now_s
        self._leg(length, 0.0, length / _SPEED_M_S)
        self._straight_s.append((began_s, self.now_s))

    def curve_to(self, place: np.ndarray) -> None:
        """Drive to a place (2,) along the arc that begins as it looks, or after a turn towards it
        where that would lead far around."""
        way = place - self.here[:2]
        if (chord := float(np.hypot(*way))) < 0.05:
            return
        off = float(wrap(np.arctan2(way[1], way[0]) - self.here[2]))
        if abs(off) > np.radians(60):
            self.turn_by(off - np.sign(off) * np.radians(40))
            off = float(np.sign(off) * np.radians(40))
        length = chord / float(np.sinc(off / np.pi))
        self._leg(length, 2 * off, length / _SPEED_M_S)

    def stand(self, seconds: float) -> None:
        """Stand still; the middle of it is the moment of a picture."""
        began_s = self.now_s
        self._leg(0.0, 0.0, seconds)
        middle = round((began_s + self.now_s) / 2 / STEP_S)
        self._stops_s.append(middle * STEP_S)

    def lift_to(self, place: np.ndarray) -> None:
        """Be put elsewhere, (3,) x, y, heading, which the odometry does not notice."""
        self._append(np.zeros((STEPS_A_MESSAGE, 3)))
        self._lifts_s.append(self.now_s + STEP_S / 2)
        self._truth.append(Pose.stack([Pose.planar(*place)]))
        self._report.append(self._report[-1][-1:])
        self._steps += 1
        self._append(np.zeros((STEPS_A_MESSAGE - 1, 3)))

    def ride(self) -> Ride:
        """What happened so far."""
        return Ride(
            Pose.joined(self._truth),
            Pose.joined(self._report),
            self._stops_s,
            self._straight_s,
            self._lifts_s,
            self.scale_errors,
            self._swing is not None,
        )

    def _leg(self, length: float, turn: float, seconds: float) -> None:
        """A leg of one curvature, as long as a whole number of messages."""
        messages = int(np.ceil(seconds / (STEP_S * STEPS_A_MESSAGE) - 1e-9))
        if messages == 0:
            return
        count = messages * STEPS_A_MESSAGE
        # The chord of an arc points half the turn to the side.
        chord, half = length / count * float(np.sinc(turn / count / (2 * np.pi))), turn / count / 2
        step = [chord * np.cos(half), chord * np.sin(half), turn / count]
        self._append(np.tile(step, (count, 1)))

    def _append(self, steps: np.ndarray) -> None:
        """Drive level steps (n, 3); in space it also rises, sinks and leans on them."""
        here, told, how = (
            self._truth[-1][-1],
            self._report[-1][-1],
            (self._noise, self.scale_errors),
        )
        if self._swing is None:
            moved = scattered(steps, *how, self._random) * self._kept(len(steps))
            truth, report = chained(here, moved), chained(told, steps)
        else:
            swung = self._swing.on(steps)
            moved = scattered_in_space(swung, *how, self._random)
            kept = self._kept(len(steps))
            moved = Pose(so3.exp(so3.log(moved.rotation) * kept), moved.translation * kept)
            truth, report = chained_in_space(here, moved), chained_in_space(told, swung)
        self._truth.append(truth[1:])
        self._report.append(report[1:])
        self._steps += len(steps)

    def _kept(self, count: int) -> np.ndarray:
        """How much of each step is not lost to slip, which comes in bursts, (count, 1)."""
        if not self._slip:
            return np.ones((count, 1))
        starts = self._random.random(count) < _SLIPS_A_SECOND * STEP_S
        burst = np.ones(round(_SLIP_S / STEP_S))
        return 1 - self._slip * np.minimum(np.convolve(starts, burst)[:count], 1.0)[:, None]


class Swing:
    """How a robot in space is held beside its level way: waves of what it has driven and turned, so
    that it stands still where that does."""

    def __init__(self, random: np.random.Generator) -> None:
        self._amplitudes = _MOST_SWING * random.uniform(0.5, 1.0, 6)
        self._lengths = random.uniform(0.5, 1.5, 6)  # of driven metres and turned radians
        self._way = 0.0

    def on(self, steps: np.ndarray) -> Pose:
        """The next level steps (n, 3) as they are then."""
        gone = np.hypot(steps[:, 0], steps[:, 1]) + np.abs(steps[:, 2])
        ways = self._way + np.concatenate([[0.0], np.cumsum(gone)])
        self._way = float(ways[-1])
        swung = self._amplitudes * np.sin(ways[:, None] / self._lengths)
        held = Pose.identity().repeated(len(ways)).disturbed(swung)
        return held[:-1].inverse() @ Pose.planar(*steps.T) @ held[1:]


def told_noise(recipe: Recipe) -> OdometryNoise:
    """What the site file says of every robot's odometry."""
    plain = OdometryNoise(**(_IN_SPACE if recipe.in_space else {}))
    scales = {"distance_scale": recipe.scale, "heading_scale": recipe.scale}
    return structs.replace(_times(plain, recipe.noise), **scales)


def true_noise(recipe: Recipe) -> OdometryNoise:
    """How the odometry truly scatters."""
    return _times(told_noise(recipe), 1 / recipe.stated)


def _times(noise: OdometryNoise, factor: float) -> OdometryNoise:
    return structs.replace(noise, **{name: factor * getattr(noise, name) for name in _SCATTERS})
