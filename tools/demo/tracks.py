"""What a demo's recordings hold: ways, uncertainties, and how long corrections took."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from trigpoint.base.clock import NANOSECONDS
from trigpoint.base.errors import RecordingError
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import Odometry, PoseEstimate, PoseStamped
from trigpoint.contract.topics import (
    CAMERA_POSE,
    CORRECTED,
    CORRECTION,
    ODOMETRY,
    ROBOT_POSE,
    SUGGESTION,
    Topic,
    node_of,
)
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.recorder.session.recording import Recording, open_recording
from trigpoint.tools.report.demo.results import Series, Track

_TOPICS = (ODOMETRY, ROBOT_POSE, CAMERA_POSE, CORRECTION, CORRECTED, SUGGESTION)


class Tracks:
    """Everything of one run, whose recorder may have begun several files; time 0 is `epoch_ns`."""

    def __init__(self, sessions: Sequence[Path], *, epoch_ns: int) -> None:
        self._epoch_ns = epoch_ns
        self._poses: dict[tuple[Topic, str], dict[int, tuple[Pose, Array]]] = defaultdict(dict)
        self._delays_s: dict[tuple[str, int], float] = {}
        self.counts: dict[str, int] = defaultdict(int)
        for recording in _opened(sessions):
            self._read(recording)

    def track(self, topic: Topic, node: str) -> Track:
        """Where a topic has a robot; odometry too, since the map begins as its frame."""
        rows = self._poses[topic, node]
        stamps = sorted(rows)
        return Track.of(self._seconds(stamps), Pose.stack([rows[stamp][0] for stamp in stamps]))

    def suggestion(self, robot: str) -> Pose | None:
        """Where the robot was last told to go next."""
        rows = self._poses[SUGGESTION, robot]
        return rows[max(rows)][0] if rows else None

    @property
    def latencies_s(self) -> Array:
        """Of every correction: from the middle of the exposure to its sending, seconds."""
        return np.array([delay_s for _, delay_s in sorted(self._delays_s.items())])

    def uncertainty(self, cameras: Iterable[str]) -> tuple[Series, ...]:
        """Each camera's sigma over time, as far as it was located."""
        found = []
        for camera in cameras:
            estimates = self._poses[CAMERA_POSE, camera]
            if estimates:
                stamps = sorted(estimates)
                traces = [float(np.trace(estimates[stamp][1][:3, :3])) for stamp in stamps]
                found.append(Series(camera, self._seconds(stamps), np.sqrt(traces)))
        return tuple(found)

    def _read(self, recording: Recording) -> None:
        for key, count in recording.counts.items():
            self.counts[key] += count
        for sample in recording.samples(_TOPICS):
            message = decode(sample.topic.type_name, sample.payload)
            node = node_of(sample.key)
            if isinstance(message, PoseEstimate):
                self._poses[sample.topic, node][message.stamp_ns] = message.pose, message.covariance
            elif isinstance(message, (Odometry, PoseStamped)):
                self._poses[sample.topic, node][message.stamp_ns] = message.pose, np.zeros((6, 6))
            if sample.topic is CORRECTION and isinstance(message, PoseEstimate):
                delay_s = (sample.published_ns - message.stamp_ns) / NANOSECONDS
                self._delays_s[node, message.stamp_ns] = delay_s

    def _seconds(self, stamps_ns: Sequence[int]) -> Array:
        return np.array([(stamp - self._epoch_ns) / NANOSECONDS for stamp in stamps_ns])


def _opened(sessions: Sequence[Path]) -> list[Recording]:
    """The recordings that hold anything; a recorder that was killed at once leaves an empty one."""
    recordings = []
    for path in sessions:
        try:
            recordings.append(open_recording(path))
        except RecordingError:
            if len(sessions) == 1:
                raise
    return recordings
