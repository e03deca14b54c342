"""What the cameras of a drawn session see, and what becomes of it on the way to a message."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import exp
from trigpoint.site.target import Target
from trigpoint.tools.simulation.sight.seen_corners import SeenFace, seen_faces_each, told_name
from trigpoint.tools.simulation.world import Shown

from .recipe import Recipe
from .ride import Ride
from .room import Camera

_WILD_PX = 60.0
_LEAST_DISPLACED_PX, _MOST_DISPLACED_PX = 8.0, 40.0
# How fast a floor's slope changes from place to place.
_FLOOR_WAVES, _SHORTEST_WAVE_M = 4, 1.5


class Carrier(Struct, frozen=True, eq=False):
    """A robot: what the site file says it carries, what it truly carries, where it goes."""

    name: str
    told: Target
    carried: Target
    ride: Ride


class Picture(Struct, frozen=True, eq=False):
    """What a camera saw at a true time; `faces` is never empty. Of a sighting that is wrong as a
    whole, displaced or misnamed, no corner is good."""

    camera: str
    t_s: float
    faces: tuple[Shown, ...]

    @property
    def is_good(self) -> bool:
        """Whether any sighting is not wrong as a whole."""
        return any(face.is_good.any() for face in self.faces)

    def stamp_ns(self, offset_s: float) -> int:
        """Nanoseconds after the session's start, on a clock that is so far ahead."""
        return to_ns(self.t_s) + to_ns(offset_s)


def faces_in_sight(recipe: Recipe, target: Target, base: np.ndarray, camera: Camera) -> list[int]:
    """Ids of the faces that a camera finds of a robot at (3,) x, y, heading."""
    poses = Pose.stack([Pose.planar(*base)])
    [seen] = seen_faces_each(target, poses, camera.map_from_camera, camera.model, ())
    return [shown.face.id for shown in seen if shown.is_found(recipe.smallest_square_px)]


def pictures_of(
    recipe: Recipe, camera: Camera, carriers: list[Carrier], times_s: np.ndarray
) -> list[Picture]:
    """The pictures of a camera at true times (n,) in which something is found."""
    bases = [_as_it_stands(recipe, carrier, times_s) for carrier in carriers]
    seen: list[list[tuple[Carrier, SeenFace]]] = [[] for _ in times_s]
    hung = np.searchsorted([move.at_s for move in camera.moves], times_s, "right")
    for place in np.unique(hung):
        rows = np.flatnonzero(hung == place)
        pose = camera.pose_at(float(times_s[rows[0]]))
        there = [(carrier, base[rows]) for carrier, base in zip(carriers, bases, strict=True)]
        for carrier, base in there:
            others = tuple((other.carried, at) for other, at in there if other is not carrier)
            each = seen_faces_each(carrier.carried, base, pose, camera.model, (), others)
            for row, faces in zip(rows.tolist(), each, strict=True):
                found = (face for face in faces if face.is_found(recipe.smallest_square_px))
                seen[row] += [(carrier, face) for face in found]
    pictures = []
    for t_s, faces in zip(times_s.tolist(), seen, strict=True):
        random = recipe.random("picture", camera.name, round(t_s * 1000))
        shown = tuple(_shown(recipe, face, carrier, carriers, random) for carrier, face in faces)
        pictures += [Picture(camera.name, t_s, shown)] if shown else []
    return pictures


def _as_it_stands(recipe: Recipe, carrier: Carrier, times_s: np.ndarray) -> Pose:
    """map_from_base with what no site file knows: the floor's slope and the target's sway."""
    base = carrier.ride.at(times_s)
    if not recipe.tilt_deg and not recipe.wobble_m:
        return base
    lean, sway = np.zeros((len(times_s), 3)), np.zeros((len(times_s), 3))
    for row, t_s in enumerate(times_s.tolist()):
        random = recipe.random("sway", carrier.name, round(t_s * 1000))
        lean[row, :2] = np.radians(recipe.tilt_deg) * random.standard_normal(2)
        sway[row] = recipe.wobble_m * random.standard_normal(3)
    if recipe.is_tilt_smooth:
        lean[:, :2] = np.radians(recipe.tilt_deg) * _floor(recipe, base.translation[:, :2])
    turned = exp(lean) @ base.rotation
    return Pose(turned, base.translation + (base.rotation @ sway[..., None])[..., 0])


def _floor(recipe: Recipe, places: np.ndarray) -> np.ndarray:
    """The floor's slope (n, 2) at places (n, 2), of variance 1: a sum of waves."""
    random = recipe.random("floor")
    angles = random.uniform(0, 2 * np.pi, (2, _FLOOR_WAVES))
    lengths = _SHORTEST_WAVE_M * random.uniform(1, 4, _FLOOR_WAVES)
    directions = np.stack([np.cos(angles[0]), np.sin(angles[0])])
    phase = 2 * np.pi * (places @ directions) / lengths + angles[1]
    amplitudes = random.standard_normal((_FLOOR_WAVES, 2)) * np.sqrt(2 / _FLOOR_WAVES)
    return np.sin(phase) @ amplitudes


def _shown(
    recipe: Recipe,
    seen: SeenFace,
    carrier: Carrier,
    carriers: list[Carrier],
    random: np.random.Generator,
) -> Shown:
    """The sighting of a face with its noise and what goes wrong with it."""
    count, told = len(seen.corners), carrier.told.face(seen.face.id)
    pixels = seen.pixels + recipe.sigma_px / recipe.stated * _noise(recipe, count, random)
    chances, angle = random.random(3), random.uniform(0, 2 * np.pi)
    size_px = _displacement(recipe, random)
    is_displaced = bool(chances[0] < recipe.displaced_share)
    if is_displaced:
        pixels = pixels + size_px * np.array([np.cos(angle), np.sin(angle)])
    wild = random.random(count) < recipe.wild_share
    pixels = pixels + wild[:, None] * random.uniform(-1, 1, (count, 2)) * _WILD_PX
    is_turned = bool(told.reads_from_both_ends and chances[1] < 0.5)
    if is_turned:
        pixels = pixels[::-1]
    name = told_name(carrier.told, (other.told for other in carriers if other is not carrier))
    sighting = seen.sighting(carrier.told, name, pixels, recipe.sigma_px)
    same_size = (face.id for face in carrier.told.faces if face.corner_count == told.corner_count)
    others = [number for number in same_size if number != told.id]
    may_be_misnamed = sighting.face >= 0 and others
    is_misnamed = bool(may_be_misnamed and chances[2] < recipe.misnamed_share)
    if is_misnamed:
        sighting = replace(sighting, face=int(random.choice(others)))
    is_good = ~wild & (not is_displaced and not is_misnamed)
    return Shown(sighting, carrier.name, told.id, is_turned, is_good)


def _noise(recipe: Recipe, count: int, random: np.random.Generator) -> np.ndarray:
    """(count, 2) of variance 1."""
    if recipe.has_tails:
        return random.standard_t(3, (count, 2)) / np.sqrt(3)
    return random.standard_normal((count, 2))


def _displacement(recipe: Recipe, random: np.random.Generator) -> float:
    low, high = np.log([_LEAST_DISPLACED_PX, _MOST_DISPLACED_PX])
    drawn = float(np.exp(random.uniform(low, high)))
    return drawn if recipe.displaced_px is None else recipe.displaced_px
