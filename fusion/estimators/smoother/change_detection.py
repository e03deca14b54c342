"""Live change detection: what sightings that contradict the rest mean.

- One alone is an outlier, and is rejected.
- A camera was moved where it alone contradicts, repeatedly, while others agree.
- A robot was lifted where every camera contradicts it from a moment on; the association finds when.

Until it is decided contradicting sightings are not used, so that no correction rests on them.
"""

from collections import defaultdict

from trigpoint.fusion.estimators.smoother import camera_relocation
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.solver.filter import Filter

from .batch import BatchSolution

_LEAST_WRONG = 3
_GROWTH = 1.5


class ChangeDetector:
    """The contradicting sightings since the last ones that agreed. Not thread-safe."""

    def __init__(self, batch: BatchSolution) -> None:
        self._batch = batch
        self._of_robot: dict[str, list[int]] = defaultdict(list)
        self._of_camera: dict[str, list[int]] = defaultdict(list)
        # How often other cameras agreed with its robots since a camera began to contradict.
        self._agreed: dict[str, int] = defaultdict(int)
        self._tried: dict[str, int] = {}

    @property
    def undecided(self) -> set[int]:
        """The sightings whose meaning is not known yet."""
        runs = [*self._of_robot.values(), *self._of_camera.values()]
        return {index for run in runs for index in run}

    def note(self, index: int, known: Filter) -> bool:
        """Note the verdict on a located camera's sighting; whether the data set changed, so that
        everything must be solved again."""
        observation = self._batch.data.entries[index].observation
        camera, robot = observation.camera, observation.robot
        if observation.verdict is Verdict.ACCEPTED:
            self._of_robot.pop(robot, None)
            self._of_camera.pop(camera, None)
            return any(self._is_camera_moved(other, known) for other in self._agree(observation))
        if observation.verdict is not Verdict.REJECTED:
            return False
        self._of_robot[robot].append(index)
        if not self._of_camera[camera]:
            self._agreed[camera] = 0
        self._of_camera[camera].append(index)
        return self._is_camera_moved(camera, known)

    def _agree(self, observation: Observation) -> list[str]:
        """The cameras that contradicted this robot before another one agreed with it."""
        found = []
        for camera, wrong in self._of_camera.items():
            first = self._batch.data.entries[wrong[0]].observation
            if first.robot == observation.robot and first.stamp_ns < observation.stamp_ns:
                self._agreed[camera] += 1
                found.append(camera)
        return found

    def _is_camera_moved(self, camera: str, known: Filter) -> bool:
        wrong = self._of_camera[camera]
        if len(wrong) < _LEAST_WRONG or not self._agreed[camera] or not known.has_camera(camera):
            return False
        if not self._is_worth_trying(camera, len(wrong)):
            return False
        entries = self._batch.data.entries
        since_ns = min(entries[index].observation.stamp_ns for index in wrong)
        return self._settled(
            camera_relocation.relocate(self._batch, camera, since_ns, known), camera
        )

    def is_robot_lifted(self, robot: str) -> bool:
        """Whether to look for a lift of the robot now: every camera contradicts it."""
        wrong = self._of_robot.get(robot, [])
        cameras = {self._batch.data.entries[index].observation.camera for index in wrong}
        if len(wrong) < _LEAST_WRONG or len(cameras) < 2:
            return False
        return self._is_worth_trying(f"robot {robot}", len(wrong))

    def forget(self, robot: str) -> None:
        """Forget what contradicted a robot."""
        wrong = set(self._of_robot.pop(robot, []))
        for camera in [name for name, run in self._of_camera.items() if wrong & set(run)]:
            del self._of_camera[camera]

    def _is_worth_trying(self, camera: str, count: int) -> bool:
        """Whether there are half as many again as at the last try."""
        if count < _GROWTH * self._tried.get(camera, 0):
            return False
        self._tried[camera] = count
        return True

    def _settled(self, is_decided: bool, *cameras: str) -> bool:
        if is_decided:
            self._of_robot.clear()
            for camera in cameras:
                self._of_camera.pop(camera, None)
                self._tried.pop(camera, None)
        return is_decided
