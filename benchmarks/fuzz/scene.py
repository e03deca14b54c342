"""What an input is about: a checkerboard in a picture, so that more than the first check is met."""

from functools import cached_property

import numpy as np

TEXELS = 8
_LEAST_PX = 3.0
_BEND = (0.0, 0.0, 1.0, 1.0, 0.0, *[0.0] * 24)


class Scene:
    """A board of `columns` × `rows` corners, a unit apart, in a picture of `size` (h, w).

    `cell`: pixels of a square; `homography`: (3, 3), from the board to pixels.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.columns, self.rows = rng.integers(1, 8, 2).tolist()
        self.cell = float(rng.uniform(_LEAST_PX, 14.0))
        self.size = self._size()
        turn, flat = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.0)
        turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self.homography = np.eye(3)
        self.homography[:2, :2] = self.cell * (
            turned @ np.diag([1, flat]) if rng.random() < 0.5 else np.eye(2)
        )
        middle = np.array([self.columns - 1, self.rows - 1]) / 2
        self.homography[2, :2] = rng.normal(0, 0.01, 2) * (rng.random() < 0.5)
        aim = np.array(self.size[::-1]) / 2
        self.homography[:2, 2] = aim - self.homography[:2, :2] @ middle

    def _size(self) -> tuple[int, int]:
        rng, kind = self._rng, self._rng.random()
        if kind < 0.7:
            need = (np.array([self.rows, self.columns]) + 3) * self.cell
            height, width = (need * rng.uniform(0.6, 1.3, 2)).astype(int).tolist()
        elif kind < 0.95:
            height, width = rng.integers(0, rng.choice([3, 9, 40])[()] + 1, 2).tolist()
        elif kind < 0.999:
            height, width = int(rng.integers(0, 3)), int(rng.integers(0, 4000))
        else:
            height, width = rng.integers(400, 2700, 2).tolist()
        return (height, width) if rng.random() < 0.5 else (width, height)

    @cached_property
    def places(self) -> np.ndarray:
        """The corners on the board, (n, 2)."""
        return np.stack(np.divmod(np.arange(self.columns * self.rows), self.columns)[::-1], 1) * 1.0

    @cached_property
    def pixels(self) -> np.ndarray:
        """The corners in the picture, (n, 2), nearly."""
        rays = self.places @ self.homography[:, :2].T + self.homography[:, 2]
        noise = self._rng.choice([0.0, 0.05, 2.0]) * self._rng.normal(size=self.places.shape)
        return rays[:, :2] / rays[:, 2:] + noise

    @property
    def squares(self) -> np.ndarray:
        """Squares about the corners on the board, their corners clockwise, (n, 8)."""
        around = 0.3 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return (self.places[:, None] + around).reshape(-1, 8)

    @property
    def quads(self) -> np.ndarray:
        """The same in the picture, (n, 8)."""
        rays = self.squares.reshape(-1, 2) @ self.homography[:, :2].T + self.homography[:, 2]
        return (rays[:, :2] / rays[:, 2:]).reshape(-1, 8)

    @property
    def grid(self) -> np.ndarray:
        """Places, pixels and whether the square before is dark, (n, 5)."""
        is_dark = self.places.sum(1, keepdims=True) % 2
        return np.hstack([self.places, self.pixels, is_dark])

    @property
    def fit(self) -> np.ndarray:
        """The board in the picture, as a fit crosses the border, (45,); sometimes with a lens."""
        height, width = self.size
        scale = max(np.hypot(width, height) / 2, 1.0)
        centre = np.array([width - 1, height - 1]) / 2
        rays = self.homography.copy()
        rays[:2] = (rays[:2] - centre[:, None] * rays[2]) / scale
        lens = self._rng.normal(0, 0.1, 2) * (self._rng.random() < 0.3)
        bend = np.array(_BEND)
        if self._rng.random() < 0.3:
            bend[4], bend[5:] = self._rng.integers(0, 6), self._rng.normal(0, 0.3, 24)
        return np.concatenate([rays.reshape(-1), lens, centre, [scale, 0, 0], bend])

    @property
    def printed(self) -> np.ndarray:
        """The board as it is printed, TEXELS a square, and a square more on each side."""
        y, x = np.indices(((self.rows + 1) * TEXELS, (self.columns + 1) * TEXELS)) // TEXELS
        return np.where((x + y) % 2, 0, 255).astype(np.uint8)

    @property
    def shown(self) -> np.ndarray:
        """The board in a grey picture of `size`."""
        y, x = np.indices(self.size, np.float32)
        u, v, w = (row[0] * x + row[1] * y + row[2] for row in np.linalg.pinv(self.homography))
        w = np.where(w == 0, 1, w)
        u, v = u / w, v / w
        is_in = (u >= -1) & (v >= -1) & (u < self.columns) & (v < self.rows)
        # Edges as a sharp lens has them.
        light = 0.8 * self.cell * np.sin(np.pi * u) * np.sin(np.pi * v)
        return np.where(is_in, 125 + 85 * np.clip(light, -1, 1), 210).astype(np.uint8)

    def picture(self) -> np.ndarray:
        """A grey picture of `size`: the board, chequers, noise, spots or one grey."""
        rng, kind = self._rng, self._rng.random()
        if kind < 0.1:
            return np.full(self.size, rng.integers(0, 256), np.uint8)
        if kind < 0.25:
            return rng.integers(0, 256, self.size, np.uint8)
        y, x = np.indices(self.size)
        if kind < 0.4:
            step = int(rng.integers(1, 9))
            grey = np.where((x // step + y // step) % 2, 40, 210)
        elif kind < 0.55:
            step = int(rng.integers(6, 40))
            grey = np.where((x % step > 0.3 * step) & (y % step > 0.3 * step), 40, 210)
        else:
            grey = self.shown
        if rng.random() < 0.3:
            grey = np.clip(grey + rng.normal(0, 8, self.size), 0, 255)
        return grey.astype(np.uint8)
