"""A camera of a known network that was shifted by less than the network is known in its map, and by
more than the cameras are known beside each other."""

import numpy as np
from msgspec.structs import replace
from support.fusion.drives import (
    RobotPlan,
    Session,
    circle,
    lab_cameras,
    lab_plan,
    make_session,
    pushed,
)

from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.tools.simulation.sight.targets import target_of

RADIUS_M = 2.4
LAP_S = 37.7
SHIFT_M = 0.03
OF_THE_MAP = np.array([0.1, 0.1, 0.01])  # its origin, m, and heading, rad
OF_EACH = np.repeat([1e-3, 3e-4], 3)


def by_map(poses: dict[str, Pose]) -> Array:
    """How the poses (n) are disturbed with their map, (6n, 3)."""
    found = np.zeros((len(poses), 6, 3))
    for part, pose in zip(found, poses.values(), strict=True):
        x, y, _ = pose.translation
        part[[0, 1, 5], [0, 1, 2]] = 1.0
        part[:2, 2] = -y, x
    return found.reshape(-1, 3)


def driven(shift_m: float, *, laps: float = 2.0) -> tuple[Session, Network]:
    """A drive past five known cameras, the second of which was shifted along the floor since."""
    robot = RobotPlan(circle(radius=RADIUS_M), target_of("charuco"))
    cameras = lab_cameras(5, radius=RADIUS_M)
    poses = {name: camera.map_from_camera for name, camera in cameras.items()}
    together = by_map(poses) * OF_THE_MAP
    covariance = together @ together.T + np.diag(np.tile(OF_EACH**2, len(poses)))
    shifted = poses["c2"].disturbed(np.array([shift_m, 0, 0, 0, 0, 0]))
    cameras["c2"] = replace(cameras["c2"], map_from_camera=shifted)
    plan = lab_plan(cameras=cameras, robots={"r1": robot}, seconds=laps * LAP_S + 1.5)
    session = make_session(plan)
    known = KnownCameras(poses, np.linalg.inv(covariance))
    session = replace(session, inputs=replace(session.inputs, known=known))
    return session, pushed(session.inputs, session.messages).results().network


def apart_m(one: Pose, other: Pose) -> float:
    return float(np.linalg.norm(one.translation - other.translation))


def off_m(session: Session, network: Network, camera: str) -> float:
    """How far a camera is from where it is."""
    record = network.cameras[camera].map_from_camera
    assert record is not None
    return apart_m(record.pose, session.plan.cameras[camera].map_from_camera)


def test_a_shift_is_noticed_at_the_second_pass_and_spoils_no_neighbour() -> None:
    session, network = driven(SHIFT_M)
    (earlier,) = network.cameras["c2"].earlier
    before = session.inputs.known.poses["c2"]
    assert apart_m(earlier.map_from_camera.pose, before) < 0.01
    assert off_m(session, network, "c2") < SHIFT_M / 3
    for camera in ("c1", "c3", "c4", "c5"):
        assert not network.cameras[camera].earlier
        assert off_m(session, network, camera) < 1e-3


def test_a_camera_that_hangs_where_it_did_was_not_moved() -> None:
    session, network = driven(0.0)
    assert not any(camera.earlier for camera in network.cameras.values())
    assert off_m(session, network, "c2") < 1e-3


def test_one_pass_does_not_decide_it() -> None:
    """All that it shows may be wrong."""
    _, network = driven(SHIFT_M, laps=0.9)
    assert not any(camera.earlier for camera in network.cameras.values())
