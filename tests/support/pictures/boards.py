"""Pictures of boards for tests: drawn by code, seen through a lens, with the true corners."""

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, exp
from trigpoint.site.target import NOWHERE, Face, Pattern, Target
from trigpoint.tools.simulation.drawing.lens_grid import directions_on_grid

CAMERA = CameraModel(640, 480, 540.0, 542.0, 322.0, 237.0, (-0.25, 0.06, 5e-4, -3e-4, 0.0))
DARK, LIGHT, GROUND = 30.0, 215.0, 110.0
_CELL_PX = 48
_SUPERSAMPLING = 2
_FINER = 2
_COARSE = 8  # of the supersampled pixels; faces are larger by far

Placed = tuple[Face, Pose]
"""A face and camera_from_face."""
HELD = (
    (-0.13, -0.1, 0.62, 30, 20),
    (0.14, -0.09, 0.65, -35, 10),
    (-0.12, 0.1, 0.6, 20, -35),
    (0.12, 0.1, 0.64, -25, -25),
    (0.0, 0.0, 0.5, 40, 0),
    (0.02, 0.01, 0.5, 0, 42),
    (-0.03, 0.0, 0.9, -40, 15),
    (0.05, 0.05, 0.45, 10, -20),
)
"""x, y, distance, tilt and yaw of a board that is held as a lens needs it."""


def checkerboard(columns: int = 9, rows: int = 7, *, number: int = 0) -> Face:
    """A checkerboard of 3 cm squares."""
    return Face(number, Pattern.CHECKERBOARD, columns, rows, 0.03, *NOWHERE)


CHARUCO_TARGET = """\
name = "box"
[[faces]]
id = 0
pattern = "charuco"
columns = 5
rows = 4
square = 0.06
marker = 0.045
dictionary = "DICT_4X4_250"
translation = [0.0, 0.0, 0.0]
quaternion = [0.0, 0.0, 0.0, 1.0]
"""
"""The file of a target that is the board `charuco()` alone."""


def charuco(
    columns: int = 5,
    rows: int = 4,
    *,
    number: int = 0,
    first: int = 0,
    legacy: bool = False,
    inverted: bool = False,
) -> Face:
    """A ChArUco board of 6 cm squares."""
    return Face(
        number,
        Pattern.CHARUCO,
        columns,
        rows,
        0.06,
        *NOWHERE,
        marker=0.045,
        dictionary="DICT_4X4_250",
        first_marker=first,
        legacy=legacy,
        inverted=inverted,
    )


def aprilgrid(
    columns: int = 4, rows: int = 3, *, number: int = 0, first: int = 0, border_bits: int = 1
) -> Face:
    """An AprilGrid of 6 cm tags at a pitch of 8 cm."""
    return Face(
        number,
        Pattern.APRILGRID,
        columns,
        rows,
        0.08,
        *NOWHERE,
        marker=0.06,
        dictionary="DICT_APRILTAG_36h11",
        first_marker=first,
        border_bits=border_bits,
    )


def target_of(*faces: Face, name: str = "box") -> Target:
    """A target with these faces."""
    return Target(name, faces)


def placed(
    face: Face,
    *,
    distance: float = 0.7,
    x: float = 0.0,
    y: float = 0.0,
    turn_deg: float = 0.0,
    tilt_deg: float = 0.0,
    yaw_deg: float = 0.0,
) -> Placed:
    """The face with its middle at (x, y, distance) of the camera, metres; turned in its own plane,
    clockwise as seen; tilted about x and then y."""
    turn = exp([0.0, 0.0, np.radians(turn_deg)])
    lean = exp([np.radians(tilt_deg), 0.0, 0.0]) @ exp([0.0, np.radians(yaw_deg), 0.0])
    rotation = lean @ turn
    middle = face.outline.mean(axis=0)
    return face, Pose(rotation, np.array([x, y, distance]) - rotation @ middle)


def true_pixels(view: Placed, camera: CameraModel = CAMERA) -> Array:
    """Where the face's corners are, (n, 2)."""
    face, camera_from_face = view
    return camera.project(camera_from_face @ face.corners)


def picture_of(
    views: Sequence[Placed],
    *,
    camera: CameraModel = CAMERA,
    noise: float = 0.0,
    blur_px: float = 0.4,
    seed: int = 0,
) -> np.ndarray:
    """The faces before a plain ground, farthest first, (height, width) uint8."""
    directions = _directions(camera)
    light = np.full(directions.shape[:2], GROUND, np.float32)
    for face, camera_from_face in sorted(views, key=lambda view: -view[1].translation[2]):
        light = _with_face(light, directions, face, camera_from_face)
    size = (camera.width, camera.height)
    picture = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    if blur_px > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), blur_px)
    return _developed(picture, noise, seed)


def held_pictures(count: int = len(HELD)) -> list[np.ndarray]:
    """Noisy pictures of the board `charuco()`, held in so many ways."""
    views = [
        placed(charuco(), x=x, y=y, distance=distance, tilt_deg=tilt, yaw_deg=yaw)
        for x, y, distance, tilt, yaw in HELD[:count]
    ]
    return [picture_of([view], noise=2.0, seed=number) for number, view in enumerate(views)]


def write_pictures(folder: Path, pictures: Iterable[np.ndarray]) -> Path:
    """A folder of 0.png, 1.png and so on."""
    folder.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{number}.png"), picture)
    return folder


def fine_picture_of(
    views: Sequence[Placed],
    *,
    camera: CameraModel = CAMERA,
    noise: float = 0.0,
    blur_px: float = 0.4,
    seed: int = 0,
) -> np.ndarray:
    """Like `picture_of`, drawn so finely that its corners are true to a hundredth of a pixel."""
    larger = _FINER * camera.parameters[:4]
    shift = (_FINER - 1) / 2  # of a pixel's centre
    fine = CameraModel(
        _FINER * camera.width,
        _FINER * camera.height,
        float(larger[0]),
        float(larger[1]),
        float(larger[2]) + shift,
        float(larger[3]) + shift,
        camera.distortion,
    )
    picture = picture_of(views, camera=fine, blur_px=0.0)
    size = (camera.width, camera.height)
    light = cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    light = cv2.GaussianBlur(light, (0, 0), blur_px)
    return _developed(light, noise, seed)


def plain_picture(*, noise: float = 0.0, level: float = GROUND, seed: int = 0) -> np.ndarray:
    """A picture of nothing, (480, 640) uint8."""
    return _developed(np.full((480, 640), level), noise, seed)


def _developed(light: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """Light as the grey values (h, w) uint8 of a camera with this noise."""
    shown = light + np.random.default_rng(seed).normal(0.0, noise, light.shape) if noise else light
    return np.clip(shown, 0, 255).round().astype(np.uint8)


def cluttered_picture(seed: int) -> np.ndarray:
    """Rectangles upon rectangles, with noise, (480, 640) uint8."""
    random = np.random.default_rng(seed)
    picture = np.full((480, 640), GROUND, np.float32)
    for _ in range(120):
        x, y = random.integers(-50, 600, 2).tolist()
        width, height = random.integers(8, 160, 2).tolist()
        shade = float(random.uniform(20, 240))
        cv2.rectangle(picture, (x, y), (x + width, y + height), shade, -1)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.8) + random.normal(0, 3, picture.shape)
    return np.clip(picture, 0, 255).round().astype(np.uint8)


def worst_error(pixels: np.ndarray, ids: np.ndarray, view: Placed) -> float:
    """The largest distance of a sighting's corner from where it is, pixels."""
    return float(np.linalg.norm(pixels - true_pixels(view)[ids.astype(int)], axis=-1).max())


@cache
def _directions(camera: CameraModel) -> np.ndarray:
    """Where every pixel of the supersampled picture looks, (height, width, 2)."""
    u, v = (
        (np.arange(size * _SUPERSAMPLING) + 0.5) / _SUPERSAMPLING - 0.5
        for size in (camera.width, camera.height)
    )
    return directions_on_grid(camera, u, v).astype(np.float32)


def _with_face(
    light: np.ndarray, directions: np.ndarray, face: Face, camera_from_face: Pose
) -> np.ndarray:
    """The supersampled picture with a face drawn over it."""
    texture, origin, scale = _texture(face)
    plane = np.column_stack([camera_from_face.rotation[:, :2], camera_from_face.translation])
    back = np.linalg.inv(plane).astype(np.float32)

    def hits(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Texels that directions meet, and whether the sheet is there."""
        hit = seen @ back[:, :2].T + back[:, 2]
        depth = np.where(hit[..., 2] > 1e-6, hit[..., 2], 1.0)
        # A texel's middle is half a texel from its edge.
        x = hit[..., 0] / depth * scale + origin - 0.5
        y = hit[..., 1] / depth * scale + origin - 0.5
        height, width = texture.shape
        inside = (hit[..., 2] > 1e-6) & (x > 0) & (y > 0) & (x < width - 1) & (y < height - 1)
        return x, y, inside

    part = _part(hits(directions[::_COARSE, ::_COARSE])[2])
    x, y, inside = hits(directions[part])
    value = cv2.remap(texture, x, y, cv2.INTER_LINEAR).astype(np.float32)
    drawn = light.copy()
    drawn[part] = np.where(inside, DARK + (LIGHT - DARK) * value / 255, light[part])
    return drawn


def _part(coarse: np.ndarray) -> tuple[slice, slice]:
    """The part of a picture around what a coarse look found, which one of two looks beside it may
    have missed; all of it where it found nothing."""
    if not coarse.any():
        return np.s_[:, :]
    rows, columns = (np.flatnonzero(coarse.any(axis=axis)) for axis in (1, 0))
    down, across = (
        slice(max(0, (found[0] - 2) * _COARSE), (found[-1] + 3) * _COARSE)
        for found in (rows, columns)
    )
    return down, across


@cache
def _texture(face: Face) -> tuple[np.ndarray, float, float]:
    """The printed sheet, where its corner 0 is (texels from the outer edge, in x as in y), and
    texels a metre."""
    scale = _CELL_PX / face.square
    if face.pattern is Pattern.APRILGRID:
        sheet, margin = _tags(face), 0
    else:
        board = _squares(face) if face.pattern is Pattern.CHECKERBOARD else _charuco_board(face)
        sheet, margin = board, _CELL_PX
    edge = _CELL_PX // 2
    shown = cv2.copyMakeBorder(sheet, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=255)
    return (255 - shown if face.inverted else shown), float(edge + margin), scale


def _squares(face: Face) -> np.ndarray:
    x, y = np.meshgrid(np.arange(face.columns), np.arange(face.rows))
    cells = np.where((x + y) % 2 == 0, 0, 255).astype(np.uint8)
    return np.kron(cells, np.ones((_CELL_PX, _CELL_PX), np.uint8))


def _charuco_board(face: Face) -> np.ndarray:
    ids = np.arange(face.first_marker, face.first_marker + face.marker_count)
    board = cv2.aruco.CharucoBoard(
        (face.columns, face.rows), face.square, face.marker or 0.0, _dictionary(face), ids
    )
    board.setLegacyPattern(face.legacy)
    return board.generateImage((face.columns * _CELL_PX, face.rows * _CELL_PX), marginSize=0)


def _tags(face: Face) -> np.ndarray:
    side = round((face.marker or 0.0) / face.square * _CELL_PX)
    height, width = ((count - 1) * _CELL_PX + side for count in (face.rows, face.columns))
    sheet = np.full((height, width), 255, np.uint8)
    fine = 20 * side  # so many that a cell has whole texels
    for tag in range(face.columns * face.rows):
        row, column = divmod(tag, face.columns)
        drawn = cv2.aruco.generateImageMarker(
            _dictionary(face), face.first_marker + tag, fine, borderBits=face.border_bits
        )
        drawn = cv2.resize(drawn, (side, side), interpolation=cv2.INTER_AREA)
        y, x = row * _CELL_PX, column * _CELL_PX
        sheet[y : y + side, x : x + side] = drawn
    return sheet


def _dictionary(face: Face) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, face.dictionary or ""))
