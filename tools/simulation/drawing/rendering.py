"""Pictures that a simulated camera takes: the rooms, the robots and their targets, light and noise.

A picture depends on the world, its seed, the camera and the number of the picture alone.
"""

from functools import cached_property

import cv2
import numpy as np

from trigpoint.geometry import Pose
from trigpoint.tools.simulation.motion.actors import SimulatedRobot
from trigpoint.tools.simulation.world import World

from .background import draw_background, vignette
from .lens_grid import subpixel_rays
from .robot import Canvas, Region, draw_robot, region_of

EXPOSURES = 4  # instants over the exposure time that are averaged where a robot moves
_NOISE_SIDE = 2048
_REACH = 2  # of the lens's blur, pixels


class CameraRenderer:
    def __init__(self, world: World, camera: str, *, noise: bool = True) -> None:
        """`noise` False: without the sensor's noise, for tests of the geometry."""
        self._world = world
        self._camera = world.camera(camera)
        self._noise_sigma = self._camera.noise if noise else 0.0
        self._rays = subpixel_rays(self._camera.model)
        self._background = draw_background(self._camera, world.walls, self._rays)
        self._vignette = vignette(self._camera)
        height, width = self._vignette.shape
        self._empty = self._developed(self._background.picture, np.s_[0:height, 0:width])

    def picture(self, index: int) -> np.ndarray:
        """Picture `index` (from 0) of the camera's time grid; (h, w) uint8."""
        picture = self.picture_at(float(self._camera.time_of(index)))
        return self._with_noise(picture, index) if self._noise_sigma > 0 else picture

    def picture_at(self, t_s: float) -> np.ndarray:
        """A picture without noise, its exposure's middle at world time `t_s`."""
        picture = self._empty.copy()
        in_view = [(robot, self._region(robot, t_s)) for robot in self._far_to_near(t_s)]
        drawn = [(robot, region) for robot, region in in_view if region is not None]
        if drawn:
            light = self._background.picture.copy()
            for robot, region in drawn:
                self._draw(light, region, robot, t_s)
            for _, region in drawn:
                picture[region] = self._developed(light, region)
        return picture

    def _region(self, robot: SimulatedRobot, t_s: float) -> Region | None:
        camera_from_map = self._camera.map_from_camera.inverse()
        return region_of(
            self._camera.model, camera_from_map @ robot.map_from_base(t_s), robot.target
        )

    def _far_to_near(self, t_s: float) -> list[SimulatedRobot]:
        eye = self._camera.map_from_camera.translation

        def distance(robot: SimulatedRobot) -> float:
            return -float(np.linalg.norm(robot.map_from_base(t_s).translation - eye))

        return sorted(self._world.robots.values(), key=distance)

    def _draw(self, light: np.ndarray, region: Region, robot: SimulatedRobot, t_s: float) -> None:
        """Draw a robot over its part of the picture, where no wall is before it."""
        # A rolling shutter sees the robot when the middle of its rows is exposed, and goes on.
        middle = (region[0].start + region[0].stop - 1) / 2
        seen_s = t_s + float(self._camera.row_delay_s(middle))
        canvas = Canvas(self._camera.model, self._rays, region, light[region].copy())
        if self._camera.line_delay_s:
            before = robot.map_from_base(seen_s).inverse()
            canvas.onward = lambda v: (
                before @ robot.map_from_base(t_s + self._camera.row_delay_s(v))
            )
        camera_from_map = self._camera.map_from_camera.inverse()
        draw_robot(canvas, robot, camera_from_map, self._instants(robot, seen_s))
        near = self._ground_distance(robot.map_from_base(t_s))
        free = self._background.wall_distance[region] > near
        np.copyto(light[region], canvas.grey, where=free)

    def _developed(self, light: np.ndarray, region: Region) -> np.ndarray:
        """The grey values of a part of `light`: blurred by the lens, darker to the edge."""
        if self._camera.blur_px <= 0:
            return cv2.convertScaleAbs(light[region] * self._vignette[region])
        top, left = max(0, region[0].start - _REACH), max(0, region[1].start - _REACH)
        around = light[top : region[0].stop + _REACH, left : region[1].stop + _REACH]
        size = (2 * _REACH + 1, 2 * _REACH + 1)
        blurred = cv2.GaussianBlur(around, size, self._camera.blur_px)
        rows = slice(region[0].start - top, region[0].stop - top)
        columns = slice(region[1].start - left, region[1].stop - left)
        return cv2.convertScaleAbs(blurred[rows, columns] * self._vignette[region])

    def _ground_distance(self, map_from_base: Pose) -> float:
        gap = map_from_base.translation - self._camera.map_from_camera.translation
        return float(np.hypot(gap[0], gap[1]))

    def _instants(self, robot: SimulatedRobot, t_s: float) -> Pose:
        """True poses spread evenly over the exposure; one where the robot stands."""
        exposure_s = self._camera.exposure_s
        ends = robot.map_from_base(t_s + np.array([-0.5, 0.5]) * exposure_s)
        if np.array_equal(ends.translation[0], ends.translation[1]):
            return ends[:1]
        shares = (np.arange(EXPOSURES) + 0.5) / EXPOSURES - 0.5
        return robot.map_from_base(t_s + shares * exposure_s)

    def _with_noise(self, picture: np.ndarray, index: int) -> np.ndarray:
        """Add a part of one large field of noise, another one for each picture."""
        random = self._world.random("picture", self._camera.name, index)
        height, width = picture.shape
        top = int(random.integers(_NOISE_SIDE - height))
        left = int(random.integers(_NOISE_SIDE - width))
        brighter, darker = self._noise
        part = np.s_[top : top + height, left : left + width]
        return cv2.subtract(cv2.add(picture, brighter[part]), darker[part])

    @cached_property
    def _noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Positive and negative parts of the noise, in whole grey values."""
        random = self._world.random("noise", self._camera.name)
        field = random.standard_normal((_NOISE_SIDE, _NOISE_SIDE), np.float32)
        whole = np.round(field * np.float32(self._noise_sigma)).astype(np.int16)
        return np.maximum(whole, 0).astype(np.uint8), np.maximum(-whole, 0).astype(np.uint8)
