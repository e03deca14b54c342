"""Reports of lifted robots and moved cameras, as text."""

import numpy as np

from trigpoint.base.clock import NANOSECONDS
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Lift
from trigpoint.fusion.model.problem import State

_LIFTED, _MOVED = "robot_lifted", "camera_moved"
CHANGES = frozenset({_LIFTED, _MOVED})
"""The kinds of events that are reported."""


def report_changes(data: DataSet, state: State) -> None:
    """Add an event for each change of the site."""
    for alike in data.changes:
        lifts = [event for event in alike if isinstance(event, Lift)]
        if lifts:
            data.note(_LIFTED, _of_robot(data, lifts))
        for move in alike:
            if isinstance(move, CameraMove):
                data.note(_MOVED, _of_camera(data, state, move))


def _of_robot(data: DataSet, lifts: list[Lift]) -> str:
    robots = " or ".join(dict.fromkeys(lift.robot for lift in lifts))
    first_ns, last_ns = min(lift.after_ns for lift in lifts), max(lift.before_ns for lift in lifts)
    text = (
        f"robot {robots} was put down elsewhere {_span(data, first_ns, last_ns)} while its "
        "odometry showed nothing; its trajectory is split there, and it is looked for anew"
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
        f"camera {move.camera} was moved{by} {_span(data, move.until_ns, move.since_ns)}; it is "
        "looked for anew, and what it saw before stays with its earlier place"
    )


def _span(data: DataSet, first_ns: int, last_ns: int) -> str:
    """The time span as text: between which times of the session, or before which."""
    first, last = ((ns - data.epoch_ns) / NANOSECONDS for ns in (first_ns, last_ns))
    if first_ns == last_ns:
        return f"before {last:.1f} s of the session"
    return f"between {first:.1f} s and {last:.1f} s of the session"
