"""A robot's true way and what its odometry reports of it, leg by leg.

Every leg is driven as reported and the truth scatters about the report, by the letter of the
contract; the next leg starts from where the robot truly is, as if somebody watched it.
"""

from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import wrap
from trigpoint.site.config import OdometryNoise
from trigpoint.tools.simulation.motion.odometry import chained
from trigpoint.tools.simulation.motion.way import scattered

from .recipe import Recipe

STEP_S = 0.01  # true poses; pictures are taken at them
STEPS_A_MESSAGE = 5  # 20 Hz
_SPEED_M_S, _TURN_RAD_S = 0.4, 0.9
_SLIP_S, _SLIPS_A_SECOND = 0.5, 0.1
# Of a robot that moves in space, as the defaults are of one in the plane.
_VERTICAL, _TILT = 0.003, 0.003


@dataclass(frozen=True, slots=True, eq=False)
class Ride:
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
        """The same, standing at its end until then."""
        more = round(end_s / STEP_S) - len(self.map_from_base) + 1
        return replace(
            self,
            map_from_base=_held(self.map_from_base, more),
            odom_from_base=_held(self.odom_from_base, more),
        )


class Driver:
    """Drives a robot and keeps what happened."""

    def __init__(
        self, recipe: Recipe, robot: str, start: np.ndarray, *, odometry_start: np.ndarray
    ) -> None:
        """`start`, `odometry_start`: (3,) x, y, heading in the map and as reported."""
        self._random = recipe.random("wheels", robot)
        self._noise = true_noise(recipe)
        self._slip = recipe.slip
        self._swing = Swing.drawn(self._random) if recipe.in_space else None
        self.scale_errors = self._random.standard_normal(2) * recipe.scale
        self._truth, self._report = [Pose.planar(*start)], [Pose.planar(*odometry_start)]
        self._steps = 0
        self._stops_s: list[float] = []
        self._straight_s: list[tuple[float, float]] = []
        self._lifts_s: list[float] = []

    @property
    def here(self) -> np.ndarray:
        """Where it truly is: (3,) x, y, heading."""
        pose = self._truth[-1][-1] if self._truth[-1].translation.ndim > 1 else self._truth[-1]
        return np.array([*pose.translation[:2], pose.heading])

    @property
    def now_s(self) -> float:
        return self._steps * STEP_S

    def turn_to(self, heading_rad: float) -> None:
        """Turn on the spot."""
        turn = float(wrap(heading_rad - self.here[2]))
        self.turn_by(turn)

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
        self._stand_quietly()
        self._lifts_s.append(self.now_s + STEP_S / 2)
        self._truth.append(Pose.stack([Pose.planar(*place)]))
        self._report.append(_last(self._report[-1]))
        self._steps += 1
        self._stand_quietly(STEPS_A_MESSAGE - 1)

    def ride(self) -> Ride:
        """What happened so far."""
        return Ride(
            _joined(self._truth),
            _joined(self._report),
            self._stops_s,
            self._straight_s,
            self._lifts_s,
            self.scale_errors,
            self._swing is not None,
        )

    def _stand_quietly(self, steps: int = STEPS_A_MESSAGE) -> None:
        self._append(np.zeros((steps, 3)))

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
        if self._swing is not None:
            self._append_in_space(steps, self._swing)
        else:
            moved = scattered(steps, self._noise, self.scale_errors, self._random)
            if self._slip:
                moved = moved * (1 - self._slip * self._slipping(len(steps)))[:, None]
            self._truth.append(chained(_last(self._truth[-1])[0], moved)[1:])
            self._report.append(chained(_last(self._report[-1])[0], steps)[1:])
        self._steps += len(steps)

    def _append_in_space(self, steps: np.ndarray, swing: "Swing") -> None:
        """The same while it also rises, sinks and leans."""
        before, after = swing.along(steps)
        level = Pose.planar(steps[:, 0], steps[:, 1], steps[:, 2])
        reported = before.inverse() @ level @ after
        slip = 1 - self._slip * self._slipping(len(steps))[:, None] if self._slip else 1.0
        moved = scattered_in_space(reported, self._noise, self.scale_errors, slip, self._random)
        self._truth.append(_followed(_last(self._truth[-1])[0], moved))
        self._report.append(_followed(_last(self._report[-1])[0], reported))

    def _slipping(self, count: int) -> np.ndarray:
        """Which of the steps lie in a burst, (count,) of 0 and 1."""
        starts = self._random.random(count) < _SLIPS_A_SECOND * STEP_S
        burst = np.ones(round(_SLIP_S / STEP_S))
        return np.minimum(np.convolve(starts, burst)[:count], 1.0)


class Swing:
    """How a robot in space is held beside its level way: waves of what it has driven and turned, so
    that it stands still where that does."""

    def __init__(self, amplitudes: np.ndarray, lengths: np.ndarray) -> None:
        """Both (6,): of each part of a pose, m and rad; of driven metres and turned radians."""
        self.amplitudes, self.lengths = amplitudes, lengths
        self._way = 0.0

    @classmethod
    def drawn(cls, random: np.random.Generator) -> "Swing":
        most = np.array([0.03, 0.03, 0.15, 0.15, 0.15, 0.1])
        return cls(most * random.uniform(0.5, 1.0, 6), random.uniform(0.5, 1.5, 6))

    def along(self, steps: np.ndarray) -> tuple[Pose, Pose]:
        """Level base to base before and after each of the next steps (n, 3)."""
        gone = np.hypot(steps[:, 0], steps[:, 1]) + np.abs(steps[:, 2])
        ways = self._way + np.concatenate([[0.0], np.cumsum(gone)])
        self._way = float(ways[-1])
        swung = self.amplitudes * np.sin(ways[:, None] / self.lengths)
        held = Pose.identity().repeated(len(ways)).disturbed(swung)
        return held[:-1], held[1:]


def scattered_in_space(
    reported: Pose,
    noise: OdometryNoise,
    scale_errors: np.ndarray,
    slip: np.ndarray | float,
    random: np.random.Generator,
) -> Pose:
    """True motion (n) of reported steps (n) in space, with the contract's noise in all directions;
    `slip` (n, 1): the share of each that is not lost."""
    turns = so3.log(reported.rotation)
    moves = np.linalg.solve(so3.left_jacobian(turns), reported.translation[..., None])[..., 0]
    variances = step_variances(noise, np.linalg.norm(moves, axis=1), np.linalg.norm(turns, axis=1))
    draw = random.standard_normal((len(turns), 6))
    shift = np.sqrt(variances.translation) * draw[:, :3]
    shift = (so3.exp(0.5 * turns) @ shift[..., None])[..., 0]
    turns = turns * (1 + scale_errors[1]) * slip
    moves = moves * (1 + scale_errors[0]) * slip
    true = Pose(so3.exp(turns), (so3.left_jacobian(turns) @ moves[..., None])[..., 0])
    return true.disturbed(np.hstack([shift, np.sqrt(variances.rotation) * draw[:, 3:]]))


def _followed(start: Pose, steps: Pose) -> Pose:
    """The poses (n) that steps (n) lead to."""
    poses = [start]
    for step in range(len(steps)):
        poses.append(poses[-1] @ steps[step])
    return Pose.stack(poses[1:])


def told_noise(recipe: Recipe) -> OdometryNoise:
    """What the site file says of every robot's odometry."""
    plain = OdometryNoise()
    return structs.replace(
        plain,
        distance=plain.distance * recipe.noise,
        lateral=plain.lateral * recipe.noise,
        heading_drive=plain.heading_drive * recipe.noise,
        heading_turn=plain.heading_turn * recipe.noise,
        vertical=_VERTICAL * recipe.noise * recipe.in_space,
        tilt=_TILT * recipe.noise * recipe.in_space,
        tilt_turn=_TILT * recipe.noise * recipe.in_space,
        distance_scale=recipe.scale,
        heading_scale=recipe.scale,
    )


def true_noise(recipe: Recipe) -> OdometryNoise:
    """How the odometry truly scatters."""
    told = told_noise(recipe)
    return structs.replace(
        told,
        distance=told.distance / recipe.stated,
        lateral=told.lateral / recipe.stated,
        heading_drive=told.heading_drive / recipe.stated,
        heading_turn=told.heading_turn / recipe.stated,
        vertical=told.vertical / recipe.stated,
        tilt=told.tilt / recipe.stated,
        tilt_turn=told.tilt_turn / recipe.stated,
    )


def _last(poses: Pose) -> Pose:
    """The last one, with a leading dimension."""
    return poses[-1:] if poses.translation.ndim > 1 else Pose.stack([poses])


def _held(poses: Pose, more: int) -> Pose:
    index = np.minimum(np.arange(len(poses) + max(more, 0)), len(poses) - 1)
    return poses[index]


def _joined(parts: list[Pose]) -> Pose:
    stacked = [part if part.translation.ndim > 1 else Pose.stack([part]) for part in parts]
    return Pose(
        np.concatenate([part.rotation for part in stacked]),
        np.concatenate([part.translation for part in stacked]),
    )
