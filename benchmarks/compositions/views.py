"""What the cameras of a drawn session see, and what becomes of it on the way to a message."""

from dataclasses import dataclass, replace

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import exp
from trigpoint.site.target import Pattern, Target
from trigpoint.tools.simulation.sight.seen_corners import SeenFace, may_be_seen, seen_faces_each

from .recipe import Recipe
from .ride import Ride
from .room import Camera

_FEWEST_CORNERS = 6
_WILD_PX = 60.0
_LEAST_DISPLACED_PX, _MOST_DISPLACED_PX = 8.0, 40.0
# How fast a floor's slope changes from place to place.
_FLOOR_WAVES, _SHORTEST_WAVE_M = 4, 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """A robot: what the site file says it carries, what it truly carries, where it goes."""

    name: str
    told: Target
    carried: Target
    ride: Ride


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """A sighting as it is sent, and what it truly shows. `is_turned`: in the order of the half
    turn; `is_displaced`, `is_misnamed`: wrong as a whole; `wild`: how many corners are."""

    sighting: FaceSighting
    robot: str
    face: int
    is_turned: bool
    is_displaced: bool
    is_misnamed: bool
    wild: int

    @property
    def is_good(self) -> bool:
        return not (self.is_displaced or self.is_misnamed)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What a camera saw at a true time; `faces` is never empty."""

    camera: str
    t_s: float
    faces: tuple[Labelled, ...]


def is_found(recipe: Recipe, seen: SeenFace) -> bool:
    """Whether a detector would find the face: a checkerboard only as a whole."""
    face = seen.face
    is_whole = face.pattern is Pattern.CHECKERBOARD
    needed = face.corner_count if is_whole else min(_FEWEST_CORNERS, face.corner_count)
    return len(seen.corners) >= needed and seen.smallest_square_px >= recipe.smallest_square_px


def faces_in_sight(recipe: Recipe, target: Target, base: np.ndarray, camera: Camera) -> list[int]:
    """Ids of the faces that a camera finds of a robot at (3,) x, y, heading."""
    poses = Pose.stack([Pose.planar(*base)])
    [seen] = seen_faces_each(target, poses, camera.map_from_camera, camera.model, ())
    return [shown.face.id for shown in seen if is_found(recipe, shown)]


def pictures_of(
    recipe: Recipe, camera: Camera, carriers: list[Carrier], times_s: np.ndarray
) -> list[Picture]:
    """The pictures of a camera at true times (n,) in which something is found."""
    bases = [_as_it_stands(recipe, carrier, times_s) for carrier in carriers]
    seen: list[list[tuple[Carrier, SeenFace]]] = [[] for _ in times_s]
    for part, pose in _between_moves(camera, times_s):
        for carrier, base in zip(carriers, bases, strict=True):
            others = [
                (other.carried, there)
                for other, there in zip(carriers, bases, strict=True)
                if other is not carrier
            ]
            for row, shown in _seen(carrier.carried, base, camera, pose, part, others):
                seen[row].append((carrier, shown))
    pictures = []
    for t_s, faces in zip(times_s.tolist(), seen, strict=True):
        random = recipe.random("picture", camera.name, round(t_s * 1000))
        found = [
            _labelled(recipe, shown, carrier, carriers, random)
            for carrier, shown in faces
            if is_found(recipe, shown)
        ]
        if found:
            pictures.append(Picture(camera.name, t_s, tuple(found)))
    return pictures


def _between_moves(camera: Camera, times_s: np.ndarray) -> list[tuple[np.ndarray, Pose]]:
    """(rows of the times, map_from_camera then) for each place at which a camera hung."""
    starts_s = [-np.inf, *(move.at_s for move in camera.moves)]
    ends_s = [*starts_s[1:], np.inf]
    parts = []
    for start_s, end_s in zip(starts_s, ends_s, strict=True):
        rows = np.flatnonzero((times_s >= start_s) & (times_s < end_s))
        if len(rows):
            parts.append((rows, camera.pose_at(float(times_s[rows[0]]))))
    return parts


def _seen(
    target: Target,
    base: Pose,
    camera: Camera,
    map_from_camera: Pose,
    rows: np.ndarray,
    others: list[tuple[Target, Pose]],
) -> list[tuple[int, SeenFace]]:
    """(row, face) of all that may be seen of a target in some rows of its poses."""
    near = rows[may_be_seen(target, base[rows], map_from_camera, camera.model)]
    if not len(near):
        return []
    beside = tuple((other, poses[near]) for other, poses in others)
    each = seen_faces_each(target, base[near], map_from_camera, camera.model, (), beside)
    return [(row, face) for row, faces in zip(near.tolist(), each, strict=True) for face in faces]


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


def _labelled(
    recipe: Recipe,
    seen: SeenFace,
    carrier: Carrier,
    carriers: list[Carrier],
    random: np.random.Generator,
) -> Labelled:
    """The sighting of a face with its noise and what goes wrong with it."""
    face, count = seen.face, len(seen.corners)
    told = carrier.told.face(face.id)
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
    number = face.id if len(carrier.told.look_alikes(told.appearance)) == 1 else -1
    others = [other.id for other in carrier.told.faces if other.corner_count == told.corner_count]
    may_be_misnamed = number >= 0 and len(others) > 1
    is_misnamed = bool(may_be_misnamed and chances[2] < recipe.misnamed_share)
    if is_misnamed:
        number = int(random.choice([other for other in others if other != number]))
    sighting = FaceSighting(
        _name(carrier, carriers),
        number,
        seen.corners,
        pixels.astype(np.float32),
        recipe.sigma_px,
    )
    return Labelled(
        sighting, carrier.name, face.id, is_turned, is_displaced, is_misnamed, int(wild.sum())
    )


def _noise(recipe: Recipe, count: int, random: np.random.Generator) -> np.ndarray:
    """(count, 2) of variance 1."""
    if recipe.has_tails:
        return random.standard_t(3, (count, 2)) / np.sqrt(3)
    return random.standard_normal((count, 2))


def _displacement(recipe: Recipe, random: np.random.Generator) -> float:
    low, high = np.log([_LEAST_DISPLACED_PX, _MOST_DISPLACED_PX])
    drawn = float(np.exp(random.uniform(low, high)))
    return drawn if recipe.displaced_px is None else recipe.displaced_px


def _name(carrier: Carrier, carriers: list[Carrier]) -> str:
    """The target's name, or "" where several robots carry the same pattern."""
    own = {face.appearance for face in carrier.told.faces}
    beside = (other.told.faces for other in carriers if other is not carrier)
    is_shared = any(face.appearance in own for faces in beside for face in faces)
    return "" if is_shared else carrier.told.name


def shifted(picture: Picture, offset_s: float) -> int:
    """The picture's stamp, nanoseconds after the session's start, on its camera's clock."""
    return to_ns(picture.t_s) + to_ns(offset_s)


def only_good(picture: Picture) -> Picture | None:
    """The picture's sightings that are not wrong as a whole."""
    faces = tuple(face for face in picture.faces if face.is_good)
    return replace(picture, faces=faces) if faces else None
