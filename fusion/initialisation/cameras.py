"""Initialisation of a camera: its pose from its observations, without an initial guess.

Candidates come from single observations (`start_poses`); the best are refined
(`camera_hypotheses`), and the best of those is accepted only where it fits and no other is nearly
as good.
"""

from dataclasses import dataclass

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.problem import State

from .camera_hypotheses import (
    ACCEPTABLE_RMS,
    MOST_HYPOTHESES,
    Hypothesis,
    Located,
    distinct,
    refine,
)
from .start_poses import spread, starts_of

_MOST_OBSERVATIONS = 24


@dataclass(frozen=True, slots=True)
class Undetermined:
    """Why a camera could not be located, as text; `rivals`: the poses that fit equally well."""

    reasons: tuple[str, ...]
    rivals: tuple[Hypothesis, ...] = ()


def locate(data: DataSet, state: State, camera: str) -> Located | Undetermined:
    """Locate a camera by those of its observations whose robot pose is known.

    One robot after the other, since how two robots stand to each other is not known here; what the
    others saw of it is fitted in once it is located.
    """
    result = Undetermined(("the robot that it saw is not located in the map yet",))
    for indices in _by_robot(data, camera):
        found = _locate(data, state, camera, indices)
        if isinstance(found, Located):
            return found
        if not result.rivals:
            result = found
    return result


def _by_robot(data: DataSet, camera: str) -> list[list[int]]:
    """The observations of a camera whose robot pose is known, the robot with most of them first."""
    robots: dict[str, list[int]] = {}
    for index, entry in enumerate(data.entries):
        if entry.observation.camera == camera and entry.map_from_base is not None:
            robots.setdefault(entry.observation.robot, []).append(index)
    return sorted(robots.values(), key=len, reverse=True)


def _locate(data: DataSet, state: State, camera: str, indices: list[int]) -> Located | Undetermined:
    few = spread(indices, _MOST_OBSERVATIONS)
    starts = starts_of(data, camera, few, most=MOST_HYPOTHESES)
    if not starts:
        return Undetermined(("no picture of it shows enough of a face to place it",))
    found = distinct(refine(data, state, camera, start, few) for start in starts)
    if not found:
        return Undetermined(("its pictures contradict each other and the odometry",))
    chosen = decide(data, found)
    if isinstance(chosen, Undetermined):
        return chosen
    if few == indices:
        return chosen.located
    final = refine(data, state, camera, chosen.located.map_from_camera, indices)
    return final.located if final is not None else chosen.located


def decide(data: DataSet, hypotheses: list[Hypothesis]) -> Hypothesis | Undetermined:
    """The hypothesis that the data support alone; they are given best first."""
    best = hypotheses[0]
    if best.rms > ACCEPTABLE_RMS:
        return Undetermined(
            (f"no pose fits its pictures (the best is off by {best.rms:.1f} sigmas)",)
        )
    alike = [h for h in hypotheses if best.lead(h) < DECISIVE]
    above = [h for h in alike if not is_below_floor(data, h)]
    if len(above) == 1 or len(alike) == 1:
        return (above or alike)[0]
    return Undetermined((_fit_alike(above or alike),), tuple(above or alike))


def is_below_floor(data: DataSet, hypothesis: Hypothesis) -> bool:
    """Whether a camera would look up through the floor at robots that drive on it.

    A face that may be turned, or a robot whose faces look alike, often allows a second pose, turned
    half about a horizontal axis, and so below the floor. Where z is free (planar = false) there is
    no floor.
    """
    indices = hypothesis.located.readings
    robots = {data.entries[index].observation.robot for index in indices}
    is_on_floor = all(data.tracks[robot].planar for robot in robots)
    return is_on_floor and hypothesis.located.map_from_camera.translation[2] < 0


def _fit_alike(hypotheses: list[Hypothesis]) -> str:
    places = [
        "({:.2f}, {:.2f}, {:.2f})".format(*h.located.map_from_camera.translation)
        for h in hypotheses
    ]
    listed = f"{', '.join(places[:-1])} and {places[-1]}"
    return (
        f"position and orientation: cameras at {listed} m fit alike; drive past it again, where it "
        "sees the robot from elsewhere"
    )
