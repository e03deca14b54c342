"""Where a rolling shutter sees the corners of a robot that moves."""

from dataclasses import replace

from numpy.typing import ArrayLike

from trigpoint.geometry import Pose
from trigpoint.tools.simulation.motion.actors import SimulatedCamera, SimulatedRobot

from .seen_corners import SeenFace

# Each round is nearer by the robot's motion in the picture over the readout's, below 1 in 100.
_ROUNDS = 4


def rolled(face: SeenFace, camera: SimulatedCamera, robot: SimulatedRobot, t_s: float) -> SeenFace:
    """A face as it is seen while the rows of the picture of world time `t_s` are exposed: each
    corner lies on the row that is exposed as it passes there."""
    if camera.line_delay_s == 0 or not len(face.corners):
        return face
    in_base = face.face.base_from_face @ face.face.corners[face.corners]
    camera_from_map = camera.map_from_camera_at(t_s).inverse()
    pixels = face.pixels
    for _ in range(_ROUNDS):
        camera_from_base = camera_from_map @ at_rows(camera, robot, t_s, pixels[:, 1])
        points = (camera_from_base.rotation @ in_base[..., None])[..., 0]
        pixels = camera.model.project(points + camera_from_base.translation)
    return replace(face, pixels=pixels)


def at_rows(camera: SimulatedCamera, robot: SimulatedRobot, t_s: float, v: ArrayLike) -> Pose:
    """The robot's true poses as the rows v (…) of a picture of world time `t_s` are exposed."""
    return robot.map_from_base(t_s + camera.row_delay_s(v))
