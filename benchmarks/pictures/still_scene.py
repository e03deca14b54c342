"""What a camera that stands still sees: real pictures, in light, weather and traffic.

A picture of a room is the world; the camera sees its middle. It is turned by the homography of a
rotation, and shifted with a depth that falls from the top to the bottom, as a floor's does.
"""

import math

import cv2
import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

FOV_DEG = 60.0
_MARGIN = 1.4
"""The world is so much larger than what the camera sees of it."""
_FAR_M, _NEAR_M = 6.0, 2.0


class Stand(Struct, frozen=True):
    """How the camera stands otherwise than at first: degrees about the vertical, the level axis and
    the line of sight; and metres to the right."""

    pan: float = 0.0
    tilt: float = 0.0
    roll: float = 0.0
    shift_m: float = 0.0


class Light(Struct, frozen=True):
    """`level`: of the light, 1 by day; `gamma`, `offset`: of the picture's grey values; `lamps`:
    (n, 4) of pools of light, their places and radii in shares of the width and their strength."""

    level: float = 1.0
    gamma: float = 1.0
    offset: float = 0.0
    lamps: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))


class Blob(Struct, frozen=True):
    """Something in the way: its middle and half axes, in shares of the width, and its looks."""

    x: float
    y: float
    across: float
    down: float
    looks: np.ndarray
    is_square: bool = False


class StillScene:
    """Draws one camera's pictures, (height, width) uint8. `sigma`: of the noise, grey levels."""

    def __init__(
        self,
        photograph: np.ndarray,
        random: np.random.Generator,
        *,
        width: int = 320,
        height: int = 240,
        sigma: float = 3.0,
    ) -> None:
        self._random, self._sigma = random, sigma
        self.width, self.height = width, height
        wide, high = round(_MARGIN * width), round(_MARGIN * height)
        self._world = _filled(photograph, wide, high).astype(np.float32)
        self._focal = width / 2 / math.tan(math.radians(FOV_DEG) / 2)
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
        self._columns, self._rows = columns, rows
        depth = np.linspace(_FAR_M, _NEAR_M, height, dtype=np.float32)
        self._inverse_depth = (1 / depth)[:, None]

    def picture(
        self,
        stand: Stand | None = None,
        light: Light | None = None,
        blobs: tuple[Blob, ...] = (),
        *,
        zoom: float = 0.0,
        drops: np.ndarray | None = None,
    ) -> np.ndarray:
        """`zoom`: the relative growth by focusing; `drops`: (n, 3) of rain on the glass, middles
        and radii in shares of the width."""
        seen = self._lit(self._seen(stand or Stand(), zoom), light or Light())
        for blob in blobs:
            shifted = self._shifted(blob, stand or Stand(), zoom)
            self._draw(seen, shifted, (light or Light()).level)
        if drops is not None:
            seen = self._through(seen, drops)
        seen += self._random.normal(0.0, self._sigma, seen.shape).astype(np.float32)
        return np.clip(seen, 0, 255).astype(np.uint8)

    def _seen(self, stand: Stand, zoom: float) -> np.ndarray:
        homography = self._world_from_picture(stand, zoom)
        if not stand.shift_m:
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            size = (self.width, self.height)
            return cv2.warpPerspective(self._world, homography, size, flags=flags)
        columns = self._columns + self._focal * stand.shift_m * self._inverse_depth
        points = np.stack([columns, self._rows, np.ones_like(columns)]).reshape(3, -1)
        x, y, w = homography @ points
        shape = columns.shape
        across, down = ((v / w).reshape(shape).astype(np.float32) for v in (x, y))
        return cv2.remap(self._world, across, down, cv2.INTER_LINEAR)

    def _world_from_picture(self, stand: Stand, zoom: float) -> np.ndarray:
        turn, _ = cv2.Rodrigues(np.radians([stand.tilt, stand.pan, 0.0]))
        roll, _ = cv2.Rodrigues(np.radians([0.0, 0.0, stand.roll]))
        lens = _pinhole(self._focal * (1 + zoom), self.width, self.height)
        world = _pinhole(self._focal, self._world.shape[1], self._world.shape[0])
        return world @ turn @ roll @ np.linalg.inv(lens)

    def _lit(self, seen: np.ndarray, light: Light) -> np.ndarray:
        """The picture in its light, as a camera with slow exposure shows it."""
        shades = np.full(seen.shape, light.level, np.float32)
        for x, y, radius, strength in light.lamps:
            far = np.hypot(self._columns / self.width - x, self._rows / self.width - y)
            shades += np.float32(strength) * np.exp(-((far / radius) ** 2))
        return 255 * np.clip(shades * seen / 255, 0, 1) ** light.gamma + light.offset

    def _shifted(self, blob: Blob, stand: Stand, zoom: float) -> Blob:
        """A thing in the room as it is seen by the turned camera, but for its roll."""
        focal = self._focal / self.width
        x = blob.x - focal * math.tan(math.radians(stand.pan)) - focal * stand.shift_m / _NEAR_M
        y = blob.y + focal * math.tan(math.radians(stand.tilt))
        half, grown = self.height / self.width / 2, 1 + zoom
        x, y = 0.5 + grown * (x - 0.5), half + grown * (y - half)
        return replace(blob, x=x, y=y, across=grown * blob.across, down=grown * blob.down)

    def _draw(self, seen: np.ndarray, blob: Blob, level: float) -> None:
        size = (
            max(2, round(2 * blob.across * self.width)),
            max(2, round(2 * blob.down * self.width)),
        )
        looks = level * cv2.resize(blob.looks, size).astype(np.float32)
        left, top = (
            round((blob.x - blob.across) * self.width),
            round((blob.y - blob.down) * self.width),
        )
        x0, y0 = max(left, 0), max(top, 0)
        x1, y1 = min(left + size[0], self.width), min(top + size[1], self.height)
        if x1 <= x0 or y1 <= y0:
            return
        part = looks[y0 - top : y1 - top, x0 - left : x1 - left]
        if blob.is_square:
            seen[y0:y1, x0:x1] = part
            return
        mask = np.zeros(size[::-1], np.uint8)
        cv2.ellipse(
            mask, (size[0] // 2, size[1] // 2), (size[0] // 2, size[1] // 2), 0, 0, 360, 1, -1
        )
        inside = mask[y0 - top : y1 - top, x0 - left : x1 - left] > 0
        seen[y0:y1, x0:x1][inside] = part[inside]

    def _through(self, seen: np.ndarray, drops: np.ndarray) -> np.ndarray:
        """A drop is a small lens, out of focus: it shows what is about it upside down."""
        across, down = self._columns.copy(), self._rows.copy()
        for x, y, radius in drops * self.width:
            least_x, least_y = (max(0, int(value - radius)) for value in (x, y))
            about = np.s_[least_y : int(y + radius) + 2, least_x : int(x + radius) + 2]
            inside = np.hypot(self._columns[about] - x, self._rows[about] - y) < radius
            across[about][inside] = x - 3 * (across[about][inside] - x)
            down[about][inside] = y - 3 * (down[about][inside] - y)
        return cv2.remap(seen, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def _pinhole(focal: float, width: int, height: int) -> np.ndarray:
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])


def _filled(photograph: np.ndarray, width: int, height: int) -> np.ndarray:
    """A picture that fills this size, its middle cut out."""
    scale = max(width / photograph.shape[1], height / photograph.shape[0])
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    sized = cv2.resize(photograph, None, fx=scale, fy=scale, interpolation=interpolation)
    top, left = (sized.shape[0] - height) // 2, (sized.shape[1] - width) // 2
    return sized[max(top, 0) :, max(left, 0) :][:height, :width]
