"""Rendered pictures of the simulated lab with the true corners of the faces in them."""

from collections.abc import Sequence
from functools import cache, cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Target
from trigpoint.tools.simulation.drawing.rendering import CameraRenderer
from trigpoint.tools.simulation.motion.actors import SimulatedCamera
from trigpoint.tools.simulation.sight.seen_corners import SeenFace
from trigpoint.tools.simulation.world import World, load_world

SEED = 1
# A square whose shortest side in the picture is less need not be found.
LEAST_SQUARE_PX = 8.0


class TrueFace(Struct, frozen=True, eq=False):
    """`pixels`: (n, 2), where every corner is; `is_whole`: whether all can be seen, and their
    squares are large enough for a detector to be asked for them."""

    face: Face
    pixels: Array
    is_whole: bool


class View(Struct, frozen=True, eq=False):
    """A picture, (h, w) uint8, and the faces that turn their front to the camera."""

    picture: np.ndarray
    faces: tuple[TrueFace, ...]

    @property
    def whole(self) -> int:
        """How many faces a detector should find."""
        return sum(face.is_whole for face in self.faces)


class Gallery:
    """The pictures of the demo's drive with one kind of target, taken when asked for.

    `size`: width and height of the pictures, the lab's own where it is left out.
    """

    def __init__(self, target: str, *, size: tuple[int, int] | None = None) -> None:
        self.world: World = load_world("lab", seed=SEED, target=target)
        if size is not None:
            for name, camera in self.world.cameras.items():
                self.world.cameras[name] = _other(camera, size)
        self._renderers = {name: CameraRenderer(self.world, name) for name in self.world.cameras}

    @property
    def target(self) -> Target:
        """What the robot carries."""
        return self.world.target(self.world.first_robot)

    def with_faces(self, count: int) -> list[View]:
        """Views of whole faces, spread over the cameras and the drive."""
        return self._views(self._with_whole, count)

    def sequences(self, count: int, length: int) -> list[list[tuple[int, View]]]:
        """Runs of pictures of one camera, with their stamps, nanoseconds; each begins with a whole
        face."""
        chosen = np.linspace(0, len(self._with_whole) - 1, count).round().astype(int)
        return [self._sequence(*self._with_whole[i], length=length) for i in chosen]

    def without_faces(self, count: int) -> list[View]:
        """Views of the rooms in which no face shows its front."""
        return self._views(self._empty, count)

    def rooms(self, count: int) -> list[list[np.ndarray]]:
        """Pictures that each camera takes in a row, but for those in which a face shows its
        front."""
        return [
            [self.render(*moment) for moment in [m for m in self._empty if m[0] == name][:count]]
            for name in self.world.cameras
        ]

    def render(self, camera: str, index: int) -> np.ndarray:
        """One picture."""
        return self._renderers[camera].picture(index)

    @cached_property
    def _moments(self) -> dict[tuple[str, int], list[SeenFace]]:
        """Every other picture, by camera and number, and what is seen in it."""
        duration_s = self.world.duration_s
        return {
            (name, index): self._seen(name, index)
            for name, camera in self.world.cameras.items()
            for index in range(0, int(duration_s * camera.rate), 2)
        }

    @cached_property
    def _with_whole(self) -> list[tuple[str, int]]:
        return [moment for moment, seen in self._moments.items() if any(map(_is_whole, seen))]

    @cached_property
    def _empty(self) -> list[tuple[str, int]]:
        return [moment for moment, seen in self._moments.items() if not seen]

    def _views(self, moments: Sequence[tuple[str, int]], count: int) -> list[View]:
        chosen = np.linspace(0, len(moments) - 1, min(count, len(moments))).round().astype(int)
        return [self._view(*moments[i]) for i in chosen]

    def _sequence(self, camera: str, first: int, *, length: int) -> list[tuple[int, View]]:
        eye = self.world.camera(camera)
        last = min(first + length, int(self.world.duration_s * eye.rate))
        return [
            (round(float(eye.time_of(index)) * 1e9), self._view(camera, index))
            for index in range(first, last)
        ]

    def _view(self, camera: str, index: int) -> View:
        whole = {seen.face.id: _is_whole(seen) for seen in self._seen(camera, index)}
        faces = [
            TrueFace(face, self._pixels(camera, index, face), whole.get(face.id, False))
            for face in self.target.faces
        ]
        # Faces too slanted for the world to count them as seen still turn their front.
        shown = tuple(true for true in faces if true.face.id in whole or _is_front(true))
        return View(self.render(camera, index), shown)

    def _seen(self, camera: str, index: int) -> list[SeenFace]:
        robot = self.world.first_robot
        return self.world.seen(camera, robot, float(self.world.camera(camera).time_of(index)))

    def _pixels(self, camera: str, index: int, face: Face) -> Array:
        eye = self.world.camera(camera)
        base = self.world.map_from_base(self.world.first_robot, float(eye.time_of(index)))
        camera_from_face = eye.map_from_camera.inverse() @ base @ face.base_from_face
        return eye.model.project(camera_from_face @ face.corners)


def _is_whole(seen: SeenFace) -> bool:
    is_large = seen.smallest_square_px >= LEAST_SQUARE_PX
    return is_large and len(seen.corners) == seen.face.corner_count


def _is_front(true: TrueFace) -> bool:
    """Whether a face's x and y turn in the picture as they are printed."""
    columns = true.face.columns - 1
    across, down = true.pixels[1] - true.pixels[0], true.pixels[columns] - true.pixels[0]
    return bool(across[0] * down[1] - across[1] * down[0] > 0)


@cache
def gallery(target: str, *, size: tuple[int, int] | None = None) -> Gallery:
    """The gallery of a kind of target; its rooms are drawn once."""
    return Gallery(target, size=size)


def _other(camera: SimulatedCamera, size: tuple[int, int]) -> SimulatedCamera:
    """The camera with as wide a view on a sensor of `size`."""
    old, (width, height) = camera.model, size
    by = width / old.width
    cx, cy = width / 2 + by * (old.cx - old.width / 2), height / 2 + by * (old.cy - old.height / 2)
    wide = {"width": width, "height": height, "fx": by * old.fx, "fy": by * old.fy}
    return replace(camera, model=replace(old, **wide, cx=cx, cy=cy))
