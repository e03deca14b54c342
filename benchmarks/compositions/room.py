"""The cameras of a drawn session: where they hang, through which lens they look, what is told."""

from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import exp
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.motion.actors import Move

from .recipe import Recipe, Room

TARGET_HEIGHT_M = 0.72
_MOST_DRAWS = 1000
# Of unknown lenses, about what the recorded camera_info says: focal length (relative), principal
# point (of the width), the first two coefficients.
FOCAL_SPREAD, CENTRE_SPREAD, DISTORTION_SPREAD = 0.03, 0.01, 0.03


class Camera(Struct, frozen=True, eq=False):
    """`told`: the lens that camera_info says; `stand`: (2,) the middle of the floor before it."""

    name: str
    map_from_camera: Pose
    model: CameraModel
    told: CameraModel
    stand: np.ndarray
    time_offset_s: float = 0.0
    moves: tuple[Move, ...] = ()

    def pose_at(self, t_s: float) -> Pose:
        """map_from_camera at a true time."""
        pose = self.map_from_camera
        for move in self.moves:
            pose = pose.disturbed(move.by) if move.at_s <= t_s else pose
        return pose

    def knocked(self, at_s: float, random: np.random.Generator) -> "Camera":
        """The same, moved by 5 to 40 cm and by some degrees."""
        away = _direction(random) * random.uniform(0.05, 0.4)
        turn = _direction(random) * np.radians(random.uniform(1.0, 10.0))
        return replace(self, moves=(*self.moves, Move(at_s, np.concatenate([away, turn]))))


def cameras_of(recipe: Recipe) -> list[Camera]:
    """The cameras, in the order in which a robot passes them."""
    places = _on_walls(recipe) if recipe.room is Room.WALLS else _on_an_oval(recipe)
    return [_camera(recipe, f"c{i}", *place) for i, place in enumerate(places, start=1)]


def _on_an_oval(recipe: Recipe) -> list[tuple[np.ndarray, np.ndarray]]:
    """Each camera's position, and what it looks at; the oval grows with their number."""
    random, count = recipe.random("room"), recipe.cameras
    long_m = max(3.6, 0.7 * count) * random.uniform(0.95, 1.1)
    places = []
    for k in range(count):
        angle = 2 * np.pi * k / count + random.normal(0, 0.05)
        position = np.array([long_m * np.cos(angle), 0.75 * long_m * np.sin(angle)])
        position += random.normal(0, 0.2, 2)
        height = random.uniform(0.9, 1.55)
        inwards = -position / np.linalg.norm(position)
        look = position + random.uniform(1.0, 1.3) * _turned(inwards, random.normal(0, 0.1))
        places.append((np.append(position, height), np.append(look, TARGET_HEIGHT_M)))
    return places


def _on_walls(recipe: Recipe) -> list[tuple[np.ndarray, np.ndarray]]:
    """As `_on_an_oval`, along the walls of a rectangle of a drawn size, at drawn heights."""
    random, count = recipe.random("room"), recipe.cameras
    least = 2.0 + 0.55 * count
    size = random.uniform(max(3.5, 0.8 * least), max(5.0, 1.4 * least), 2)
    around = 2 * size.sum()
    start, places = random.uniform(0, around), []
    for k in range(count):
        along = (start + (k + random.uniform(-0.3, 0.3)) * around / count) % around
        position, inwards = _on_the_wall(along, size)
        height = random.uniform(0.6, 2.4)
        # Never steeper than 55°, which would show nothing of upright faces.
        nearest = max(0.8, (height - TARGET_HEIGHT_M) / np.tan(np.radians(55)))
        direction = _turned(inwards, random.normal(0, 0.3))
        look = position + random.uniform(nearest, nearest + 0.5) * direction
        places.append((np.append(position, height), np.append(look, TARGET_HEIGHT_M)))
    return places


def _on_the_wall(along: float, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point on a centred rectangle's edge, anticlockwise, and the direction into the room."""
    width, depth = size
    if along < width:
        return np.array([along - width / 2, -depth / 2]), np.array([0.0, 1.0])
    if along < width + depth:
        return np.array([width / 2, along - width - depth / 2]), np.array([-1.0, 0.0])
    if along < 2 * width + depth:
        return np.array([1.5 * width + depth - along, depth / 2]), np.array([0.0, -1.0])
    return np.array([-width / 2, 2 * width + 1.5 * depth - along]), np.array([1.0, 0.0])


def _camera(recipe: Recipe, name: str, position: np.ndarray, look: np.ndarray) -> Camera:
    random = recipe.random("camera", name)
    upright = looking_at(position, look).rotation
    pose = Pose(upright @ exp(random.normal(0, 0.06, 3)), position)
    model = one_to_one(lambda: _drawn_lens(recipe.lens, random))
    offset_s = random.standard_normal() * recipe.time_offset_s
    told = one_to_one(lambda: _drawn_off(model, random)) if recipe.lens_spread else model
    return Camera(name, pose, model, told, look[:2], float(offset_s))


def one_to_one(draw: Callable[[], CameraModel]) -> CameraModel:
    """A drawn lens that maps the whole picture one to one; others are drawn again."""
    for _ in range(_MOST_DRAWS):
        lens = draw()
        if _maps_one_to_one(lens):
            return lens
    raise ValueError("hardly any such lens maps its picture one to one; let them differ less")


def _maps_one_to_one(lens: CameraModel) -> bool:
    """Whether every pixel at the picture's edge has a direction that the lens brings there."""
    u, v = np.linspace(0, lens.width - 1, 9), np.linspace(0, lens.height - 1, 9)
    sides = [np.column_stack([u, np.full(9, y)]) for y in (v[0], v[-1])]
    sides += [np.column_stack([np.full(9, x), v]) for x in (u[0], u[-1])]
    directions = lens.directions(np.vstack(sides))
    if not np.all(np.isfinite(directions)):
        return False
    return bool(np.all(lens.sees(np.column_stack([directions, np.ones(len(directions))]))))


def _drawn_lens(kind: str, random: np.random.Generator) -> CameraModel:
    """`plain`: 640 × 480, about 60°, little distortion; `bent`: of drawn sizes and fields of view;
    `fisheye`: wide, by the equidistant model."""
    if kind == "plain":
        size, view_deg, model = (640, 480), random.uniform(58, 63), LensModel.PLUMB_BOB
    elif kind == "bent":
        sizes = [(640, 480), (1280, 720), (1920, 1080)]
        size = sizes[random.integers(3)]
        view_deg = random.uniform(42, 62) if size[0] == 640 else random.uniform(50, 95)
        model = LensModel.PLUMB_BOB
    else:
        size, view_deg, model = (1280, 960), random.uniform(80, 110), LensModel.EQUIDISTANT
    plain = CameraModel.from_field_of_view(*size, float(np.radians(view_deg)))
    focal = plain.fx
    if model is LensModel.EQUIDISTANT:
        focal = size[0] / np.radians(view_deg)
        distortion = random.normal(0, [0.03, 0.01, 0.002, 0.0005])
    else:
        # A wide lens is bent less a unit of x/z, or it would fold within the picture.
        bend = 0.12 / max(1.0, np.tan(np.radians(view_deg / 2)) / 0.6) ** 2
        distortion = random.normal(0, [bend, bend / 2, 0.001, 0.001, 0.0])
    centre = np.array([plain.cx, plain.cy]) + random.normal(0, 0.015 * size[0], 2)
    cx, cy = (float(value) for value in centre)
    fx, fy = float(focal), float(focal * (1 + random.normal(0, 0.003)))
    return CameraModel(*size, fx, fy, cx, cy, tuple(distortion.tolist()), model)


def _drawn_off(model: CameraModel, random: np.random.Generator) -> CameraModel:
    """A lens that is told of a camera whose true one is `model`."""
    focal = random.normal(0, FOCAL_SPREAD)
    by = np.zeros(len(model.parameters))
    by[:2] = focal * np.array([model.fx, model.fy])
    by[2:4] = random.normal(0, CENTRE_SPREAD * model.width, 2)
    by[4:6] = random.normal(0, DISTORTION_SPREAD, 2)
    return model.with_parameters(model.parameters + by)


def _direction(random: np.random.Generator) -> np.ndarray:
    vector = random.standard_normal(3)
    return vector / np.linalg.norm(vector)


def _turned(direction: np.ndarray, angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]]) @ direction
