"""What a camera sees of the empty rooms: floor, walls, furniture, posters, in grey.

Drawn once a camera, per subpixel by ray casting; the same for every seed, as the rooms are fixed.
"""

import zlib

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.tools.simulation.motion.actors import SimulatedCamera
from trigpoint.tools.simulation.sight.seen_corners import Wall

from .lens_grid import SUBPIXELS, directions_on_grid

_FAR = 1e6
_COARSE = 8  # subpixels


class Background(Struct, frozen=True, eq=False):
    """`picture`: (h, w) float32 grey values before vignetting; `wall_distance`: (h, w) float32,
    metres over ground to the wall that a pixel shows, inf where it shows none."""

    picture: np.ndarray
    wall_distance: np.ndarray


def draw_background(
    camera: SimulatedCamera, walls: tuple[Wall, ...], subpixel_rays: np.ndarray
) -> Background:
    """Cast a ray through every subpixel onto the floor and the walls."""
    model, eye = camera.model, camera.map_from_camera.translation
    rotation = camera.map_from_camera.rotation.astype(np.float32)
    rays = subpixel_rays @ rotation[:, :2].T + rotation[:, 2]
    fall = np.minimum(rays[..., 2], -1e-3)
    nearest = np.where(rays[..., 2] < -1e-3, -eye[2] / fall, _FAR).astype(np.float32)
    grey = np.zeros(nearest.shape, np.float32)
    is_wall = np.zeros(nearest.shape, dtype=bool)
    for number, wall in enumerate(walls):
        part = _part(_hits(eye, rays[::_COARSE, ::_COARSE], nearest[::_COARSE, ::_COARSE], wall)[0])
        if part is not None:
            seen, share, along, height = _hits(eye, rays[part], nearest[part], wall)
            grey[part][seen] = _wall_grey(wall, number, along[seen], height[seen])
            nearest[part][seen] = share[seen]
            is_wall[part] |= seen
    ground = ~is_wall
    grey[ground] = _floor_grey(eye, rays[ground], nearest[ground], walls)
    distance = np.where(is_wall, nearest * np.hypot(rays[..., 0], rays[..., 1]), np.inf)
    size = (model.width, model.height)
    picture = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return Background(picture, distance[::SUBPIXELS, ::SUBPIXELS].astype(np.float32))


def vignette(camera: SimulatedCamera) -> np.ndarray:
    """How much light reaches each pixel, (h, w) float32 up to 1: a lens darkens to its edge."""
    model = camera.model
    u, v = np.arange(model.width, dtype=float), np.arange(model.height, dtype=float)
    directions = directions_on_grid(model, u, v)
    return (1.0 - 0.35 * np.minimum(np.sum(directions**2, axis=-1), 1.0)).astype(np.float32)


def _part(coarse: np.ndarray) -> tuple[slice, slice] | None:
    """The part of the picture around what a coarse look found, or None. With a margin, as a lens
    bends the edges of a wall outwards between two looks."""
    if not coarse.any():
        return None
    rows, columns = (np.flatnonzero(coarse.any(axis=axis)) for axis in (1, 0))
    return _around(rows), _around(columns)


def _around(found: np.ndarray) -> slice:
    return slice(max(0, (found[0] - 2) * _COARSE), (found[-1] + 3) * _COARSE)


def _hits(
    eye: Array, rays: np.ndarray, nearest: np.ndarray, wall: Wall
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Which rays hit a wall before what is `nearest` so far; and where they meet its plane: share
    of the ray, metres along the wall, height."""
    run = wall.end - wall.start
    length = float(np.linalg.norm(run))
    across = np.array([-run[1], run[0]]) / length
    fall = rays[..., :2] @ across
    gap = float((wall.start - eye[:2]) @ across)
    share = np.divide(gap, fall, out=np.full_like(fall, _FAR), where=np.abs(fall) > 1e-9)
    # The camera's own wall, at most a few centimetres behind or before the eye, is not drawn.
    share = np.where(share > 0.05, share, _FAR)
    along = ((eye[:2] - wall.start) @ run + share * (rays[..., :2] @ run)) / length
    height = eye[2] + share * rays[..., 2]
    seen = (share < nearest) & (along >= 0) & (along <= length)
    return seen & (height >= 0) & (height <= wall.height), share, along, height


def _floor_grey(eye: Array, rays: Array, floor_at: Array, walls: tuple[Wall, ...]) -> Array:
    """Linoleum in half-metre tiles with fine speckles, darker along the walls."""
    x = eye[0] + floor_at * rays[..., 0]
    y = eye[1] + floor_at * rays[..., 1]
    tile = _hash(np.floor(x / 0.5), np.floor(y / 0.5))
    joint = np.minimum(_to_line(x, 0.5), _to_line(y, 0.5))
    speckle = _hash(np.floor(x / 0.012), np.floor(y / 0.012))
    grey = (
        126 + 10 * (tile - 0.5) + 9 * (speckle - 0.5) + 7 * np.sin(1.3 * x + 0.7) * np.cos(1.1 * y)
    )
    grey -= 26 * np.clip(1 - joint / 0.004, 0, 1)
    to_wall = np.full_like(x, 9.0)
    for wall in walls:
        np.minimum(to_wall, _to_segment(x, y, wall), out=to_wall)
    return grey * (1 - 0.35 * np.exp(-to_wall / 0.12))


def _wall_grey(wall: Wall, number: int, along: Array, height: Array) -> Array:
    """Plaster with a skirting board and posters, or cupboard doors where the wall is lower."""
    grey = 275 * wall.shade * (0.72 + 0.28 * height / wall.height)
    grey += 5 * (_hash(np.floor(along / 0.02), np.floor(height / 0.02) + 100 * number) - 0.5)
    grey *= 1 - 0.3 * np.exp(-height / 0.15)
    if wall.height < 2.5:
        return _cupboards(grey, along, height)
    length = float(np.linalg.norm(wall.end - wall.start))
    for x, bottom, width, tall, shade in _posters(number, length):
        on = np.flatnonzero(
            (along > x) & (along < x + width) & (height > bottom) & (height < bottom + tall)
        )
        grey[on] = _poster(along[on] - x, height[on] - bottom, width, tall, shade)
    return np.where(height < 0.09, 62 + 8 * (height > 0.08), grey)


def _cupboards(grey: Array, along: Array, height: Array) -> Array:
    """Doors 46 cm wide with a gap between them, a handle each, and a plinth."""
    across = along % 0.46
    gap = np.minimum(across, 0.46 - across)
    grey = grey * (1 - 0.45 * np.clip(1 - gap / 0.006, 0, 1))
    handle = (np.abs(across - 0.40) < 0.008) & (np.abs(height - 1.0) < 0.07)
    shelf = np.abs(height - 1.38) < 0.004
    grey = np.where(handle, 60.0, np.where(shelf, grey * 0.6, grey))
    return np.where(height < 0.1, 48.0, grey)


def _posters(number: int, length: float) -> list[tuple[float, float, float, float, float]]:
    """Posters, notice boards and sockets of a wall: left edge, bottom, width, height, shade."""
    random = np.random.default_rng(zlib.crc32(b"posters") + number)
    things = []
    place = random.uniform(0.2, 0.6)
    while place < length - 0.5:
        width, tall = random.uniform(0.25, 0.6), random.uniform(0.3, 0.7)
        things.append((place, random.uniform(0.55, 1.2), width, tall, random.uniform(70, 190)))
        things.append((place + width + 0.15, 0.28, 0.08, 0.08, 205.0))
        place += width + random.uniform(0.5, 1.0)
    return things


def _poster(along: Array, height: Array, width: float, tall: float, shade: float) -> Array:
    """A poster's grey values at places on it, from its lower left corner."""
    rim = np.minimum(np.minimum(along, width - along), np.minimum(height, tall - height))
    inner = shade + 22 * np.sin(9 * along / width + 2) * np.cos(7 * height / tall + shade)
    return np.where(rim < 0.012, 0.6 * shade, inner)


def _to_line(x: Array, pitch: float) -> Array:
    """Distance to the nearest multiple of `pitch`."""
    rest = x % pitch
    return np.minimum(rest, pitch - rest)


def _to_segment(x: Array, y: Array, wall: Wall) -> Array:
    run = wall.end - wall.start
    share = ((x - wall.start[0]) * run[0] + (y - wall.start[1]) * run[1]) / float(run @ run)
    share = np.clip(share, 0, 1)
    return np.hypot(x - wall.start[0] - share * run[0], y - wall.start[1] - share * run[1])


def _hash(a: Array, b: Array) -> Array:
    """A number in [0, 1) for each pair of whole numbers, as if at random."""
    value = np.sin(a * 12.9898 + b * 78.233) * 43758.5453
    return value - np.floor(value)
