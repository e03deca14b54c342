"""Drawn hours before a camera: people, doors, lamps, sun, night, rain, focusing.

What happens is drawn by the seed alone; a state is advanced second by second.
"""

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from .still_scene import Blob, Light, Stand, StillScene

_SWAY_DEG = 0.02


class StillHour:
    """One hour; `pictures` gives a picture a second. `looks`: what people and things look like."""

    def __init__(
        self, scene: StillScene, looks: list[np.ndarray], random: np.random.Generator
    ) -> None:
        self._scene, self._looks, self._random = scene, looks, random
        self._level, self._level_end = random.choice([1.0, 0.7, 0.3, 0.05, 0.015], 2)
        self._cloud = self._now_s = 0.0
        self._step_s = 1.0
        self._pools = random.uniform([0, 0, 0.1, -0.4], [1, 0.7, 0.4, 0.6], (5, 4))
        self._pools_on = random.random(5) < 0.5
        self._sun = random.uniform(-0.3, 0.3, 2)
        self._walkers: list[list[float]] = []
        self._things: list[tuple[Blob, float]] = []
        self._doors = [self._thing() for _ in range(2)]
        self._doors_open = [0.0, 0.0]
        self._gamma, self._offset = 1.0, 0.0
        self._zoom, self._zoom_until = 0.0, 0.0
        self._rains = random.random() < 0.25
        self._drops = random.uniform([0, 0, 0.01], [1, 0.75, 0.04], (25, 3))

    def _thing(self) -> Blob:
        x, y, across, down = self._random.uniform([0, 0.1, 0.03, 0.05], [1, 0.7, 0.2, 0.3])
        looks = self._looks[self._random.integers(len(self._looks))]
        return Blob(x, y, across, down, looks, is_square=True)

    def pictures(
        self, seconds: int = 3600, *, hz: int = 1, stand: Stand | None = None
    ) -> Iterator[np.ndarray]:
        """One picture after the other, `hz` a second; `stand`: where somebody put the camera."""
        put = stand or Stand()
        for number in range(seconds * hz):
            self._advance(1 / hz)
            pan, tilt = self._random.normal(0, _SWAY_DEG, 2)
            stands = replace(put, pan=put.pan + pan, tilt=put.tilt + tilt)
            yield self._scene.picture(
                stands,
                self._light(number / (seconds * hz)),
                self._blobs(),
                zoom=self._zoom,
                drops=self._drops if self._rains else None,
            )

    def _happens(self, every_s: float) -> bool:
        return self._random.random() < self._step_s / every_s

    def _advance(self, step_s: float) -> None:
        random, self._step_s = self._random, step_s
        second = self._now_s = self._now_s + step_s
        self._cloud += -0.01 * step_s * self._cloud + random.normal(0, 0.03 * step_s**0.5)
        for number in range(len(self._pools)):
            if self._happens(600):
                self._pools_on[number] = not self._pools_on[number]
        if self._happens(300):
            self._gamma, self._offset = random.uniform(0.7, 1.4), random.uniform(-10, 25)
        if self._happens(120):
            self._zoom, self._zoom_until = (
                random.uniform(-0.025, 0.025),
                second + random.uniform(1, 6),
            )
        if second > self._zoom_until:
            self._zoom = 0.0
        if self._happens(40):
            self._walkers.append(self._walker())
        self._walk()
        if self._happens(400):
            self._things.append((self._thing(), second + random.exponential(600)))
        self._things = [(thing, until) for thing, until in self._things if until > second]
        for door in range(2):
            if self._happens(90):
                self._doors_open[door] = random.uniform(0, 1)
        fresh = random.random(len(self._drops)) < 0.05 * step_s
        self._drops[fresh] = random.uniform([0, 0, 0.01], [1, 0.75, 0.04], (int(fresh.sum()), 3))

    def _walker(self) -> list[float]:
        """x, y, speed, half axes, looks, and when it stands still and for how long."""
        random = self._random
        near = random.random() < 0.1
        across = random.uniform(0.3, 0.6) if near else random.uniform(0.03, 0.15)
        side = random.choice([-1, 1])
        speed = side * random.uniform(0.05, 0.4)
        return [
            0.5 - side * (0.5 + across), random.uniform(0.25, 0.5), speed,
            across, across * random.uniform(1.5, 3), float(random.integers(len(self._looks))),
            random.uniform(0, 1), random.exponential(15),
        ]  # fmt: skip

    def _walk(self) -> None:
        for walker in self._walkers:
            stands = (walker[0] - walker[6]) * np.sign(walker[2]) > 0 and walker[7] > 0
            if stands:
                walker[7] -= self._step_s
                walker[0] += self._random.normal(0, 0.003)
            else:
                walker[0] += walker[2] * self._step_s
        self._walkers = [w for w in self._walkers if -1.5 < w[0] < 2.5]

    def _blobs(self) -> tuple[Blob, ...]:
        doors = [
            Blob(d.x, d.y, max(d.across * share, 0.01), d.down, d.looks, is_square=True)
            for d, share in zip(self._doors, self._doors_open, strict=True)
            if share > 0.1
        ]
        walkers = [Blob(w[0], w[1], w[3], w[4], self._looks[int(w[5])]) for w in self._walkers]
        return (*doors, *(thing for thing, _ in self._things), *walkers)

    def _light(self, share: float) -> Light:
        level = self._level * (self._level_end / self._level) ** share
        pools = self._pools[self._pools_on].copy()
        pools[:, :2] += share * self._sun
        pools[:, 3] *= level
        level *= float(np.exp(np.clip(self._cloud, -1, 1)))
        # The exposure follows the light, down to where there is not enough.
        exposure = min(1 / level, 8.0)
        pools[:, 3] *= exposure
        return Light(level * exposure, self._gamma, self._offset, pools)
