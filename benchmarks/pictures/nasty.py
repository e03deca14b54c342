"""Pictures over which a search could take forever: walls of squares of every size, bent and noisy
ones, noise, woven cloth, crowds of markers and of boards. Each comes out the same every time."""

from collections.abc import Iterator

import cv2
import numpy as np

from trigpoint.site.target import Face
from trigpoint.tools.simulation.drawing.textures import LEVELS, NOTHING, WHITE, texture

WIDTH, HEIGHT = 640, 480
_DARK, _LIGHT = 30, 220
_CROWDS = (2, 3, 4)


def nasty_pictures(faces: tuple[Face, ...] = ()) -> Iterator[tuple[str, np.ndarray]]:
    """What each is, and the picture, (480, 640) uint8; `faces`: those of which there are crowds."""
    for pitch in (2, 3, 4, 5, 6, 8, 10, 13, 16, 24):
        yield f"wall of {pitch} px", wall(pitch)
    random = np.random.default_rng(5)
    for pitch in (8, 12, 18):
        yield f"turned wall of {pitch} px", wall(pitch, turn=0.3)
        bent = wall(pitch, turn=0.3, bend=6.0)
        yield f"bent wall of {pitch} px", bent
        yield f"bent, noisy wall of {pitch} px", _clipped(bent + random.normal(0, 25, bent.shape))
    for level in (1, 8, 60):
        yield f"noise of {level}", _clipped(random.normal(level, level, (HEIGHT, WIDTH)))
    for cell in (3, 5, 8, 12, 20):
        yield f"cloth of {cell} px", cloth(cell, random)
    for side in (8, 12, 16, 24, 36):
        yield f"markers of {side} px", crowd_of_markers(side)
    for face in faces:
        for count in _CROWDS:
            yield f"{count * count} of {face.pattern.value}", crowd_of_boards(face, count)


def wall(pitch: int, *, turn: float = 0.0, bend: float = 0.0) -> np.ndarray:
    """Squares of `pitch` pixels, turned by radians, their lines bent by so many pixels."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    u, v = u + bend * np.sin(v / 40), v + bend * np.sin(u / 50)
    is_light = (np.floor(u / pitch) + np.floor(v / pitch)) % 2 == 1
    return np.where(is_light, _LIGHT, _DARK).astype(np.uint8)


def cloth(cell: int, random: np.random.Generator) -> np.ndarray:
    """Random cells."""
    cells = random.integers(0, 2, (HEIGHT // cell + 1, WIDTH // cell + 1)).astype(np.uint8)
    return 30 + 180 * np.kron(cells, np.ones((cell, cell), np.uint8))[:HEIGHT, :WIDTH]


def crowd_of_markers(side: int) -> np.ndarray:
    """As many markers as there is room for."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    picture = np.full((HEIGHT, WIDTH), _LIGHT, np.uint8)
    pitch = side + max(3, side // 3)
    places = [(y, x) for y in range(2, HEIGHT - side, pitch) for x in range(2, WIDTH - side, pitch)]
    for number, (y, x) in enumerate(places):
        marker = cv2.aruco.generateImageMarker(dictionary, number % 250, side)
        picture[y : y + side, x : x + side] = marker
    return picture


def crowd_of_boards(face: Face, count: int) -> np.ndarray:
    """`count` times `count` boards of a checkerboard's or ChArUco board's look, a little turned."""
    room = np.array([WIDTH // count, HEIGHT // count])
    board = _board(face, int(0.9 * min(room[0] / (face.columns + 2), room[1] / (face.rows + 2))))
    picture = np.full((HEIGHT, WIDTH), 128, np.uint8)
    for row in range(count):
        for column in range(count):
            picture[
                row * room[1] : (row + 1) * room[1], column * room[0] : (column + 1) * room[0]
            ] = _turned(board, 5.0 * column - 4.0 * row, room)
    return cv2.GaussianBlur(picture, (0, 0), 0.6)


def _board(face: Face, square: int) -> np.ndarray:
    """The board with a light margin of a square and more, `square` pixels a square."""
    finest = LEVELS[0]
    printed = texture(face, finest).texels[NOTHING:-NOTHING, NOTHING:-NOTHING, 0]
    by = square / finest
    drawn = cv2.resize(printed, None, fx=by, fy=by, interpolation=cv2.INTER_AREA)
    return np.pad(drawn, square, constant_values=WHITE)


def _turned(board: np.ndarray, degrees: float, room: np.ndarray) -> np.ndarray:
    """The board about the middle of a room (width, height) of its own."""
    height, width = board.shape
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1.0)
    matrix[:, 2] += room / 2 - (width / 2, height / 2)
    size = (int(room[0]), int(room[1]))
    return cv2.warpAffine(board, matrix, size, flags=cv2.INTER_AREA, borderValue=(128,))


def _clipped(values: np.ndarray) -> np.ndarray:
    return np.clip(values, 0, 255).astype(np.uint8)
