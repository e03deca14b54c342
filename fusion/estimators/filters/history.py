"""The outcome of each sighting that a filter processed; from these, the robots' trajectories and
the quality of the fit."""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.geometry import Pose

from .filter_state import FilterState, Innovation

# With one wrong reading in twenty, so many in a row occur once in 160,000 times.
_IN_A_ROW = 4


class Step(Struct):
    """The outcome of one sighting. `before`: the filter state before it, None where that is too
    long ago; `map_from_base`: afterwards; `innovation`: None where it was set aside."""

    time_ns: int
    entry: int
    before: FilterState | None
    map_from_base: Pose | None
    innovation: Innovation | None


def nodes_of(data: DataSet, steps: list[Step], robot: str) -> dict[int, Pose]:
    """The robot's poses after its sightings by their times, ascending."""
    nodes: dict[int, Pose] = {}
    track = data.tracks[robot]
    if robot == data.anchored_robot and len(track):
        nodes[track.first_ns] = track.odom_from_base[0]
    for step in steps:
        is_mine = data.entries[step.entry].observation.robot == robot
        if is_mine and step.map_from_base is not None:
            nodes[step.time_ns] = step.map_from_base
    return nodes


def poses_at(
    data: DataSet,
    filter_state: FilterState,
    robot: str,
    nodes: dict[int, Pose],
    stamps_ns: np.ndarray,
) -> Pose:
    """The robot at moments (m,) that odometry covers, by its nodes and its odometry."""
    track, poses = data.tracks[robot], Pose.stack(list(nodes.values()))
    nodes_ns = np.array(list(nodes))
    return interpolated(track, filter_state.scales(robot), nodes_ns, poses, stamps_ns)


# -- how well the sightings fit -------------------------------------------------------------------


def rms_px(data: DataSet, steps: list[Step], camera: str) -> float | None:
    """The residuals' RMS of a coordinate over a camera's used sightings; None without any."""
    squares = [
        step.innovation.rms_px**2
        for step in steps
        if step.innovation is not None and data.entries[step.entry].observation.camera == camera
    ]
    return float(np.sqrt(np.mean(squares))) if squares else None


def chi2_per_dof(steps: list[Step]) -> float | None:
    """χ² of all used sightings over its degrees of freedom; None where there are none."""
    used = [step.innovation for step in steps if step.innovation is not None]
    freedom = sum(innovation.total_freedom for innovation in used)
    return sum(innovation.total for innovation in used) / freedom if freedom > 0 else None


class Contradiction(Struct, frozen=True):
    """Consecutive sightings by one camera or of one robot, `what`, all of which contradict the
    filter state, which noise or a single wrong reading does not explain."""

    what: str
    since_ns: int
    until_ns: int

    @property
    def text(self) -> str:
        """The report to the user."""
        return (
            f"{_IN_A_ROW} pictures or more in a row {self.what} contradict the rest: a robot was "
            "carried, a camera was moved, or the filter went wrong and with it the cameras that it "
            'located meanwhile; run the session with estimator = "smoother"'
        )


def contradictions(data: DataSet, steps: list[Step]) -> list[Contradiction]:
    """The contradictions among the steps, in order of their ends."""
    found: list[Contradiction] = []
    runs: dict[str, list[int]] = {}
    for step in steps:
        observation = data.entries[step.entry].observation
        for what in (f"by camera {observation.camera}", f"of robot {observation.robot}"):
            if observation.verdict is Verdict.REJECTED:
                runs.setdefault(what, []).append(observation.stamp_ns)
            elif what in runs:
                found += _told({what: runs.pop(what)})
    return found + _told(runs)


def _told(runs: dict[str, list[int]]) -> list[Contradiction]:
    return [
        Contradiction(what, stamps_ns[0], stamps_ns[-1])
        for what, stamps_ns in runs.items()
        if len(stamps_ns) >= _IN_A_ROW
    ]
