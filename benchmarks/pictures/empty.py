"""Pictures in which no target is, though many look like one: floors, windows, keyboards, boards of
other makes, noise. Each is a pure function of its number.
"""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from .nasty import HEIGHT, WIDTH, cloth

_Random = np.random.Generator


def empty_pictures(count: int, *, first: int = 0) -> Iterator[np.ndarray]:
    """`count` pictures, (480, 640) uint8, of every kind by turns."""
    for number in range(first, first + count):
        yield empty_picture(number)


def empty_picture(number: int) -> np.ndarray:
    """One of them."""
    random = np.random.default_rng([7, number])
    picture = _KINDS[number % len(_KINDS)](random)
    light = _slope(random) * picture
    soft = cv2.GaussianBlur(light.astype(np.float32), (0, 0), float(random.uniform(0.4, 1.6)))
    noisy = soft + random.normal(0, random.uniform(0.5, 6.0), soft.shape)
    return np.clip(noisy, 0, 255).round().astype(np.uint8)


def _chequered_floor(random: _Random) -> np.ndarray:
    """Tiles without end, or to a skirting board, seen at a slant."""
    columns, rows = random.integers(12, 40, 2).tolist()
    tiles = (np.indices((rows, columns)).sum(axis=0) % 2).astype(np.uint8)
    return _seen(random, np.kron(tiles, np.ones((24, 24), np.uint8)), reach=1.6)


def _window(random: _Random) -> np.ndarray:
    """Bright panes with dark bars, or the other way round."""
    columns, rows = random.integers(3, 16, 2).tolist()
    bar = int(random.integers(2, 8))
    pane = np.zeros((24, 24), np.uint8)
    pane[bar:, bar:] = 1
    sheet = np.tile(pane, (rows, columns))
    return _seen(random, sheet if random.random() < 0.5 else 1 - sheet, reach=1.0)


def _keyboard(random: _Random) -> np.ndarray:
    """Rows of keys with something on each."""
    sheet = np.zeros((6 * 26, 15 * 26), np.uint8)
    for row in range(6):
        shift = int(random.integers(0, 13))
        for column in range(15):
            y, x = 26 * row + 3, 26 * column + 3 + shift
            sheet[y : y + 20, x : x + 20] = 1
            sign = random.integers(0, 2, (4, 4)).astype(np.uint8)
            shown = np.kron(sign, np.ones((3, 3), np.uint8))
            part = sheet[y + 4 : y + 16, x + 4 : x + 16]
            part &= shown[: part.shape[0], : part.shape[1]]
    return _seen(random, sheet, reach=1.0)


def _other_board(random: _Random) -> np.ndarray:
    """A checkerboard of a size that is no one's, or one whose colours are swapped."""
    columns, rows = ((7, 6), (10, 7), (6, 9), (11, 8), (5, 4), (14, 9))[int(random.integers(6))]
    squares = (np.indices((rows, columns)).sum(axis=0) % 2).astype(np.uint8)
    sheet = np.pad(np.kron(squares, np.ones((24, 24), np.uint8)), 24, constant_values=1)
    return _seen(random, sheet, reach=0.8)


def _other_markers(random: _Random) -> np.ndarray:
    """Markers of another dictionary in a grid."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    columns, rows = random.integers(2, 7, 2).tolist()
    sheet = np.ones((rows * 40, columns * 40), np.uint8)
    for row in range(rows):
        for column in range(columns):
            marker = cv2.aruco.generateImageMarker(dictionary, int(random.integers(250)), 32)
            sheet[40 * row + 4 : 40 * row + 36, 40 * column + 4 : 40 * column + 36] = marker > 127
    return _seen(random, sheet, reach=0.8)


def _clutter(random: _Random) -> np.ndarray:
    """Rectangles upon rectangles."""
    picture = np.full((HEIGHT, WIDTH), 110, np.uint8)
    for _ in range(int(random.integers(20, 200))):
        x, y = random.integers(-50, 600, 2).tolist()
        width, height = random.integers(4, 160, 2).tolist()
        shade = float(random.uniform(20, 240))
        cv2.rectangle(picture, (x, y), (x + width, y + height), (shade,), -1)
    return picture.astype(float)


def _bits(random: _Random) -> np.ndarray:
    """Coarse noise: random cells, as on a woven cloth or a code."""
    return cloth(int(random.integers(3, 20)), random)


def _noise(random: _Random) -> np.ndarray:
    """A dark picture, or a grey one, with much noise."""
    level, spread = random.uniform(0, 200), random.uniform(0, 60)
    return np.clip(random.normal(level, spread, (HEIGHT, WIDTH)), 0, 255)


_KINDS: tuple[Callable[[_Random], np.ndarray], ...] = (
    _chequered_floor,
    _window,
    _keyboard,
    _other_board,
    _other_markers,
    _clutter,
    _bits,
    _noise,
)


def _seen(random: _Random, sheet: np.ndarray, *, reach: float) -> np.ndarray:
    """A sheet of 0 and 1 from somewhere, before a plain ground; `reach`: of the picture's size."""
    height, width = sheet.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    size = reach * random.uniform(0.4, 1.0) * HEIGHT
    angle = random.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    flat = (corners - corners.mean(axis=0)) * size / max(height, width) @ turn.T
    flat *= random.uniform(0.4, 1.0, 2)
    depth = 1 + flat @ random.uniform(-0.4, 0.4, 2) / size
    middle = random.uniform(0.25, 0.75, 2) * (WIDTH, HEIGHT)
    target = (flat / depth[:, None] + middle).astype(np.float32)
    dark, light, ground = random.uniform(5, 90), random.uniform(130, 250), random.uniform(40, 180)
    matrix = cv2.getPerspectiveTransform(corners, target)
    shown = cv2.warpPerspective(sheet * 255, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
    mask = cv2.warpPerspective(np.full_like(sheet, 255), matrix, (WIDTH, HEIGHT))
    return np.where(mask > 127, dark + (light - dark) * shown / 255.0, ground)


def _slope(random: _Random) -> np.ndarray:
    """Uneven light, about 1."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, WIDTH), np.linspace(-0.5, 0.5, HEIGHT))
    along, down = random.uniform(-0.5, 0.5, 2)
    return 1 + along * x + down * y
