"""A run of the demo made up for tests: two cameras beside a straight drive."""

from typing import Any

import numpy as np
from support.fusion.networks import located

from trigpoint.geometry import Pose
from trigpoint.map.network import CameraRecord, Network, Statistics, Status
from trigpoint.tools.networks.truth import CameraError, NetworkError
from trigpoint.tools.report.demo.results import (
    CameraResult,
    DemoResults,
    KeyCount,
    RobotResult,
    Series,
    Track,
)

LOOKING_DOWN_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def make_camera(
    name: str,
    place: tuple[float, float, float] = (0.0, 1.0, 1.5),
    *,
    error: tuple[float, float, float] = (0.01, 0.0, 0.0),
    sigma: float = 0.01,
    **more: Any,
) -> CameraResult:
    """A located camera that looks along x; `error` and `sigma` in metres."""
    truth = Pose(LOOKING_DOWN_X, np.array(place))
    covariance = np.diag([sigma**2] * 3 + [1e-6] * 3)
    shift = np.array(error)
    record = located(truth.disturbed([*error, 0.001, 0.0, 0.0]), covariance, sightings=20)
    size = float(np.linalg.norm(shift))
    fields: dict[str, Any] = {
        "record": record,
        "came_by": True,
        "error": CameraError(size, 0.001, size / sigma),
        "pictures": 100,
        "skipped": 0,
    }
    return CameraResult(name, truth, **(fields | more))


def make_unlocated(
    name: str, *, came_by: bool, status: Status = "unseen", undetermined: tuple[str, ...] = ()
) -> CameraResult:
    """A camera without a pose."""
    truth = Pose(LOOKING_DOWN_X, np.array([4.0, 1.0, 1.5]))
    return CameraResult(name, truth, CameraRecord(status, undetermined), came_by)


def make_track(offset: float = 0.0, heading: float = 0.0, count: int = 51) -> Track:
    """Ten seconds along x at 1 m/s, `offset` metres to the left of it."""
    t_s = np.linspace(0.0, 10.0, count)
    places = np.stack([t_s, np.full(count, offset)], axis=-1)
    return Track(t_s, places, np.full(count, heading))


def make_robot(**more: Any) -> RobotResult:
    """A robot that odometry has 10 cm aside, fusion 1 cm."""
    fields: dict[str, Any] = {
        "truth": make_track(),
        "odometry": make_track(0.10),
        "live": make_track(0.01),
        "believed": make_track(0.02, count=11),
        "smoothed": make_track(0.005),
    }
    return RobotResult("r1", **(fields | more))


def make_key(path: str = "camera/c1/sightings", **more: Any) -> KeyCount:
    """A reliable key that lost nothing."""
    fields: dict[str, Any] = {
        "is_reliable": True,
        "sent": 100,
        "received": {"fusion/fusion": 100},
        "recorded": 100,
    }
    return KeyCount(path, **(fields | more))


def make_results(**more: Any) -> DemoResults:
    """A run that did what it should."""
    cameras = more.pop("cameras", (make_camera("c1"), make_camera("c2", (8.0, -1.0, 1.5))))
    errors = {camera.name: camera.error for camera in cameras if camera.error is not None}
    t_s = np.linspace(1.0, 10.0, 10)
    fields: dict[str, Any] = {
        "world": "lab",
        "seed": 3,
        "target": "charuco",
        "seconds": 10.0,
        "network": Network(
            "lab",
            "uuid",
            "smoother",
            {camera.name: camera.record for camera in cameras},
            {},
            Statistics(1.0, 3),
        ),
        "covariance": np.eye(6 * len(errors)) * 1e-4,
        "error": NetworkError(errors, 0.004 if len(errors) > 1 else None, None),
        "cameras": cameras,
        "robots": (make_robot(),),
        "keys": (make_key(), make_key("diagnostics", is_reliable=False, sent=None, received={})),
        "latencies_s": np.array([0.03, 0.04, 0.05]),
        "series": (Series("c1", t_s, 0.1 / t_s),),
        "walls": np.array([[[-1.0, -2.0], [10.0, -2.0]], [[-1.0, 2.0], [10.0, 2.0]]]),
    }
    return DemoResults(**(fields | more))
