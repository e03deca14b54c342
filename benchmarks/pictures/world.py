"""Our detectors against OpenCV's on pictures of one board as the world shows it, one thread each:
faces found, corners found of those found, corners against the truth.

A photograph behind it, a wide lens or a fisheye, paper that curls, a reflection upon it,
sharpening, JPEG. Each is a pure function of its kind and number.
"""

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
from msgspec import Struct

from benchmarks.compositions.carried import face_of
from benchmarks.table import Row, share_of
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.detector import detector_for
from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern, Target
from trigpoint.tools.simulation.drawing.textures import texture
from trigpoint.tools.simulation.sight.seen_corners import smallest_square

from .detection import OURS, opencv_finders, runs
from .real_sets import backgrounds
from .scoring import score_of, score_rows, sigma_row
from .views import LEAST_SQUARE_PX, TrueFace, View

_Random = np.random.Generator
FACES = {
    "checkerboard": face_of(Pattern.CHECKERBOARD, 10, 7, 0.03),
    "charuco": face_of(Pattern.CHARUCO, 7, 5, 0.04, 0.03, "DICT_4X4_50"),
}
_VIEWS = 24
_row = partial(Row, "world")
# Rays along each side of a pixel.
_FINE = 3
_TEXELS = 96
_MARGIN_PX = 6
# How often the place where a ray meets a curled sheet is mended.
_MEETINGS = 5


class Kind(Struct, frozen=True):
    """`size`: of the picture; `diagonal_deg`, `bulge`: of the lens. `curl`: how far the paper is
    from flat at most, of its width; `sheen`: the most that a reflection adds, grey levels;
    `sharpening`: of an unsharp mask; `quality`: of the JPEG."""

    size: tuple[int, int]
    diagonal_deg: float
    bulge: float
    curl: float = 0.003
    sheen: float = 0.0
    sharpening: float = 0.0
    quality: int = 95


KINDS = {
    "photograph behind": Kind((640, 480), 70, 0.3),
    "wide lens": Kind((960, 600), 115, 0.05),
    "fisheye": Kind((1032, 778), 180, 0.0),
    "curled paper": Kind((640, 480), 80, 0.2, curl=0.03),
    "sheen": Kind((640, 480), 80, 0.2, sheen=110.0),
    "sharpened, JPEG": Kind((640, 360), 90, 0.2, sharpening=1.2, quality=50),
    "small": Kind((270, 180), 90, 0.1, sharpening=0.5, quality=80),
}


def run(effort: float = 1.0) -> list[Row]:
    """Both patterns, every kind of picture."""
    count = share_of(_VIEWS, effort, least=2)
    return [row for choice in FACES for kind in KINDS for row in _rows(choice, kind, count)]


def _rows(choice: str, kind: str, count: int) -> list[Row]:
    """Recall and accuracy beside each of OpenCV's ways; a sigma beside a true one."""
    views, target = world_views(choice, kind, count), target_of(choice)
    others = opencv_finders(target, choice)
    done = runs({OURS: detector_for([target]).detect} | others, views)
    scores = {name: score_of(views, run.answers) for name, run in done.items()}
    ours, what, rows = scores[OURS], f"{choice}, {kind}", []
    share = 100 * _corner_share(views, done[OURS].answers)
    rows.append(_row(f"{what}, corners found", "%", share, 100.0, "all", more_is_better=True))
    for name in others:
        rows += score_rows(_row, what, ours, scores[name], name)
        took = (done[OURS].milliseconds, done[name].milliseconds)
        rows.append(_row(f"{what}, first search", "ms", *took, name))
    return [*rows, sigma_row(_row, what, ours)]


def _corner_share(views: list[View], answers: Sequence[Sequence[FaceSighting]]) -> float:
    """Of all corners of the faces, how many are found."""
    all_of_them = sum(true.face.corner_count for view in views for true in view.faces)
    return sum(len(found.corners) for answer in answers for found in answer) / all_of_them


def target_of(choice: str) -> Target:
    """The one board of that kind of target."""
    return Target("sheet", (FACES[choice],))


def world_views(choice: str, kind: str, count: int) -> list[View]:
    """The first `count` pictures of a kind."""
    own = list(KINDS).index(kind)
    return [
        _view(FACES[choice], KINDS[kind], np.random.default_rng([11, own, n])) for n in range(count)
    ]


def _view(face: Face, kind: Kind, random: _Random) -> View:
    lens = _lens(kind, random.uniform(-0.01, 0.01, 2))
    while True:
        sheet = _placed(face, kind, lens, random)
        pixels = lens.project(sheet.in_camera(face.corners[:, :2]))
        if _is_whole(face, pixels, kind.size):
            break
    softness = float(random.uniform(0.4, 0.8))
    light = cv2.GaussianBlur(_behind(kind.size, random), (0, 0), softness)
    left, top, right, bottom = _box(sheet, lens)
    drawn = _drawn(light[top:bottom, left:right], (left, top), sheet, lens, kind, random)
    soft = cv2.GaussianBlur(drawn, (0, 0), _FINE * softness)
    light[top:bottom, left:right] = cv2.resize(
        soft, (right - left, bottom - top), interpolation=cv2.INTER_AREA
    )
    return View(_developed(light, kind, random), (TrueFace(face, pixels, True),))


def _lens(kind: Kind, aside: Array) -> CameraModel:
    """A lens that brings a ray at an angle t from its axis to a radius that grows with
    t + bulge t³, and sees so much from corner to corner; `aside`: (2,) how far its centre is from
    the picture's, of the diagonal. A bulge of 1/3 is nearly a lens without distortion, 0 an even
    fisheye, less than 0 a stronger one."""
    angle, diagonal = np.radians(kind.diagonal_deg) / 2, float(np.hypot(*kind.size))
    focal = float(diagonal / 2 / (angle + kind.bulge * angle**3))
    x, y = ((np.array(kind.size) - 1) / 2 + aside * diagonal).tolist()
    return CameraModel(*kind.size, focal, focal, x, y, (kind.bulge,), LensModel.EQUIDISTANT)


def _rays(lens: CameraModel, pixels: Array) -> Array:
    """Unit vectors (…, 3) of pixels (…, 2)."""
    flat = lens.directions(pixels)
    rays = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


class _Sheet(Struct, frozen=True, eq=False):
    """Where a face is. `turn`: (3, 3) and `place`: (3,) of the face frame in the camera's; `curl`:
    (3,) what x², xy and y² from its middle raise it by, a metre."""

    face: Face
    turn: Array
    place: Array
    curl: Array

    def heights(self, points: Array) -> Array:
        """How far the paper is off its plane at face points (…, 2), metres."""
        x, y = np.moveaxis(points - self.face.corners[:, :2].mean(axis=0), -1, 0)
        return self.curl[0] * x * x + self.curl[1] * x * y + self.curl[2] * y * y

    def in_camera(self, points: Array) -> Array:
        """Face points (n, 2) in the camera's frame, (n, 3)."""
        return np.column_stack([points, self.heights(points)]) @ self.turn.T + self.place

    def met_by(self, rays: Array) -> tuple[Array, np.ndarray]:
        """Face points (…, 2) at which rays (…, 3) meet the paper, and whether they do (…)."""
        eye, along = -self.turn.T @ self.place, rays @ self.turn
        fall = np.where(np.abs(along[..., 2]) > 1e-6, along[..., 2], 1e-6)
        way = -eye[2] / fall
        for _ in range(_MEETINGS):
            points = eye[:2] + way[..., None] * along[..., :2]
            way = (self.heights(np.clip(points, -1.0, 1.0)) - eye[2]) / fall
        return eye[:2] + way[..., None] * along[..., :2], np.asarray(way > 0)


def _placed(face: Face, kind: Kind, lens: CameraModel, random: _Random) -> _Sheet:
    """A face somewhere in view, its squares of 10 to 40 pixels or so, turned any way."""
    pixel = random.uniform(0.15, 0.85, 2) * kind.size
    ray = _rays(lens, pixel)
    most_px = 0.7 * min(kind.size) / face.rows
    distance = lens.fx * face.square / random.uniform(10.0, max(14.0, min(40.0, most_px)))
    # Its front to the camera, but for a tilt about an axis in its plane, and turned in that.
    towards = _towards(ray)
    tilt = np.radians(random.uniform(0, 50)) * _unit(random.normal(size=2))
    roll = random.uniform(-np.pi, np.pi)
    turn = (
        towards
        @ cv2.Rodrigues(np.array([*tilt, 0.0]))[0]
        @ cv2.Rodrigues(np.array([0, 0, roll]))[0]
    )
    middle = np.append(face.corners[:, :2].mean(axis=0), 0.0)
    width = face.columns * face.square
    curl = kind.curl * random.uniform(-1, 1, 3) * 4 / width
    return _Sheet(face, turn, distance * ray - turn @ middle, curl)


def _towards(ray: Array) -> Array:
    """The turn (3, 3) whose z is a ray."""
    across = _unit(np.cross([0.0, 1.0, 0.0], ray))
    return np.column_stack([across, np.cross(ray, across), ray])


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _is_whole(face: Face, pixels: Array, size: tuple[int, int]) -> bool:
    """Whether all corners are in the picture, with squares that are large enough."""
    inside = (pixels > _MARGIN_PX) & (pixels < np.array(size) - 1 - _MARGIN_PX)
    return bool(inside.all()) and smallest_square(face, pixels) >= LEAST_SQUARE_PX


def _behind(size: tuple[int, int], random: _Random) -> np.ndarray:
    """A part of a photograph, (h, w) float32."""
    every = backgrounds()
    picture = every[int(random.integers(len(every)))]
    height, width = picture.shape
    share = min(width / size[0], height / size[1]) * random.uniform(0.6, 1.0)
    part = (np.array(size) * share).astype(int)
    left, top = (random.uniform(0, 1, 2) * (np.array([width, height]) - part)).astype(int)
    cut = picture[top : top + part[1], left : left + part[0]]
    return cv2.resize(cut, size).astype(np.float32)


def _box(sheet: _Sheet, lens: CameraModel) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the part of the picture that has the sheet."""
    face = sheet.face
    x, y = (face.square * np.linspace(-2.2, n + 0.2, 40) for n in (face.columns, face.rows))
    rim = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels = lens.project(sheet.in_camera(rim))
    low, high = pixels.min(axis=0) - _MARGIN_PX, pixels.max(axis=0) + _MARGIN_PX
    left, top = np.clip(low.astype(int), 0, None).tolist()
    right, bottom = np.clip(high.astype(int), None, (lens.width, lens.height)).tolist()
    return left, top, right, bottom


def _drawn(
    behind: np.ndarray,
    first: tuple[int, int],
    sheet: _Sheet,
    lens: CameraModel,
    kind: Kind,
    random: _Random,
) -> np.ndarray:
    """The part of the picture from pixel `first` on in finer pixels, with the sheet before what is
    `behind`, in uneven light, with its reflection."""
    height, width = (_FINE * side for side in behind.shape)
    light = cv2.resize(behind, (width, height))
    x, y = (
        (np.arange(n) + 0.5) / _FINE - 0.5 + start
        for n, start in zip((width, height), first, strict=True)
    )
    rays = _rays(lens, np.stack(np.meshgrid(x, y), axis=-1))
    points, is_before = sheet.met_by(rays)
    printed = texture(sheet.face, _TEXELS)
    texels = points.reshape(-1, 2) @ printed.matrix[:2, :2].T + printed.matrix[:2, 2]
    u, v = texels.T.reshape(2, height, width).astype(np.float32)
    seen = cv2.remap(printed.texels, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    grey, cover = seen[..., 0].astype(np.float32), seen[..., 1] / np.float32(255)
    cover = np.where(is_before, cover, 0)
    place = points / (sheet.face.columns * sheet.face.square)
    even = 1 + place @ random.uniform(-0.4, 0.4, 2)
    gleam = np.sum((place - random.uniform(0, 0.7, 2)) ** 2, axis=-1) / random.uniform(0.01, 0.06)
    shine = kind.sheen * np.exp(-np.minimum(gleam, 50.0))
    shown = np.clip(even, 0.4, 1.5) * random.uniform(0.55, 1.0) * grey + cover * shine
    return (light * (1 - cover) + np.where(is_before, shown, 0)).astype(np.float32)


def _developed(light: np.ndarray, kind: Kind, random: _Random) -> np.ndarray:
    """What a camera makes of the light: noisy, sharpened, compressed; (h, w) uint8."""
    picture = light.copy()
    picture += random.normal(0, random.uniform(1.0, 3.0), picture.shape).astype(np.float32)
    picture += kind.sharpening * (picture - cv2.GaussianBlur(picture, (0, 0), 1.0))
    whole = np.clip(picture, 0, 255).round().astype(np.uint8)
    _, packed = cv2.imencode(".jpg", whole, [cv2.IMWRITE_JPEG_QUALITY, kind.quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))
