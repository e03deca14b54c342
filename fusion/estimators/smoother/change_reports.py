"""Reports of lifted robots and moved cameras, as text."""

from collections.abc import Collection, Mapping

import numpy as np

from trigpoint.clock import NANOSECONDS
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Lift, SiteChange
from trigpoint.fusion.model.problem import State

_UNMET = "it has met no located camera yet; drive it past one"
BEHIND_A_JUMP = (
    "position and orientation in the map: the robot's odometry jumped on its way here from the "
    "other cameras; drive there without a break"
)


def report_changes(data: DataSet, state: State) -> None:
    """Add an event for each change of the site."""
    for alike in data.changes:
        lifts = [event for event in alike if isinstance(event, Lift)]
        moves = [event for event in alike if isinstance(event, CameraMove)]
        if lifts and not moves:
            data.note("robot_lifted", _of_robot(data, lifts))
        elif len(moves) == len(alike) == 1:
            data.note("camera_moved", _of_camera(data, state, moves[0]))
        else:
            data.note("undecided", _of_either(data, alike))


def _of_robot(data: DataSet, lifts: list[Lift]) -> str:
    robots = " or ".join(dict.fromkeys(lift.robot for lift in lifts))
    text = (
        f"robot {robots} was put down elsewhere {_between(data, lifts)} while its odometry showed "
        "nothing; its way is broken there, and it is located anew"
    )
    if len(lifts) > 1:
        text += "; a camera that it met only in between has no place until it drives there again"
    return text


def _of_camera(data: DataSet, state: State, move: CameraMove) -> str:
    (name,) = [m.name for m in data.moves if (m.camera, m.since_ns) == (move.camera, move.since_ns)]
    places = data.places_of(move.camera)
    after = places[places.index(name) + 1]
    by = ""
    if name in state.cameras and after in state.cameras:
        old, new = (state.cameras[place].map_from_camera for place in (name, after))
        by = f" by {np.linalg.norm(new.translation - old.translation):.2f} m"
    return (
        f"camera {move.camera} was moved{by}; it is located anew, and what it saw before stays "
        "with its earlier place"
    )


def _of_either(data: DataSet, alike: tuple[SiteChange, ...]) -> str:
    return (
        f"either {_any_of(alike)} {_between(data, alike)}; what depends on which of them has "
        "no place until the robot has passed there again"
    )


def _any_of(alike: tuple[SiteChange, ...]) -> str:
    what = dict.fromkeys(
        f"robot {event.robot} was put down elsewhere"
        if isinstance(event, Lift)
        else f"camera {event.camera} was moved"
        for event in alike
    )
    return " or ".join(what)


def why_undetermined(
    data: DataSet, camera: str, chains: Collection[str], robot_reasons: Mapping[str, str]
) -> tuple[str, ...]:
    """Why the robots' poses are not known at a camera's observations, as text.

    `chains`: the robots of the last solution; `robot_reasons`: by robot, why it could not be
    located in the map.
    """
    if (reason := _behind_a_change(data, camera)) is not None:
        return (reason,)
    robots = dict.fromkeys(entry.observation.robot for entry in data.of_camera(camera))
    if any(robot in chains for robot in robots):
        return (BEHIND_A_JUMP,)
    return tuple(
        f"the robot {robot} that it saw is not located in the map: "
        f"{robot_reasons.get(robot, _UNMET)}"
        for robot in robots
    )


def _behind_a_change(data: DataSet, camera: str) -> str | None:
    """Why a camera has no pose whose robot's trajectory is disconnected by a change, as text; None
    where that is not the reason."""
    entries = [entry.observation for entry in data.of_camera(camera) if entry.map_from_base is None]
    robots = {observation.robot for observation in entries}
    for alike in data.changes:
        if any(isinstance(event, Lift) and event.robot in robots for event in alike):
            return (
                f"position and orientation in the map: {_any_of(alike)} some time "
                f"{_between(data, alike)}, and whether before or after this camera saw the robot "
                "is not known; drive there again"
            )
    return None


def _between(data: DataSet, events: list[Lift] | tuple[SiteChange, ...]) -> str:
    """Between which times of the session."""
    first = min(e.after_ns if isinstance(e, Lift) else e.until_ns for e in events) - data.epoch_ns
    last = max(e.before_ns if isinstance(e, Lift) else e.since_ns for e in events) - data.epoch_ns
    return f"between {first / NANOSECONDS:.1f} s and {last / NANOSECONDS:.1f} s of the session"
