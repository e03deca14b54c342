"""Inputs for the kernels, drawn from how they are declared: sound ones and spoilt ones.

An input is one kernel's call, with the calls before it that its object needs. It depends on the
seed and its number alone.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import TypeVar

import numpy as np
from msgspec import Struct, field

from trigpoint.native.library import Handle, In, Kernel, Out

from . import live
from .kernels import OBJECTS, object_of
from .problem import full_system, problem, reduced
from .scene import TEXELS, Scene

T = TypeVar("T")
POISON = (
    np.nan, np.inf, -np.inf, 1e300, -1e300, 1e18, -1e18, 3e9, -3e9, 1e-300, -1.0, 0.0, 0.5, 1e4,
)  # fmt: skip
POISON_INTS = (-1, 0, 1, 5, 1000, 2**31 - 1, -(2**31), 2**62, -(2**63), 2**63 - 1)
FIT = 45
# Parameters that must fit together before a kernel looks at more.
SOUND: dict[str, Callable[[Scene], Mapping[int, np.ndarray | float]]] = {
    "tp_pattern_set": lambda scene: {1: scene.places, 2: 0 * scene.places, 3: 0.5, 4: 1.0},
    "tp_pattern_print": lambda scene: {1: scene.printed} | dict.fromkeys((2, 3, 4), float(TEXELS)),
    "tp_measured": lambda scene: {0: scene.shown, 3: scene.pixels, 5: np.array([0.4, 0.4, 0, 0])},
    "tp_placed": lambda scene: {
        2: float(scene.size[1]), 3: float(scene.size[0]), 6: 0.5, 7: 0.3,
    },
    "tp_weighed": lambda scene: {
        0: scene.shown, 1: scene.columns, 2: scene.rows,
        4: np.arange(1.0 * len(scene.places)), 5: scene.pixels,
    },
    "tp_grown": lambda scene: {2: scene.columns + scene.rows},
    "tp_corner_terms": lambda scene: {12: 1, 13: int(scene.cell > 0)},
    "tp_fit_plane": lambda scene: {0: scene.places, 1: scene.pixels},
    "tp_settled_fit": lambda scene: {0: scene.places, 1: scene.pixels, 4: 0.03},
    "tp_scatter": lambda scene: {1: scene.places, 2: scene.pixels},
    "tp_misfit": lambda scene: {2: np.sign(np.arange(len(scene.places)))},
    "tp_likeliest_wrong": lambda scene: {2: np.sign(np.arange(len(scene.places)))},
    "tp_cells": lambda scene: {0: scene.shown, 1: scene.quads, 3: 5.0},
    "tp_marker_groups": lambda scene: {
        0: np.arange(len(scene.places)), 1: scene.quads, 3: scene.squares,
        2: np.linspace(1.0, 0.5, len(scene.places)),
    },
    "tp_paths": lambda scene: {0: np.ascontiguousarray(scene.places[:, ::-1], np.int64), 1: 0},
    "tp_sound_corners": lambda scene: {0: scene.places, 1: scene.pixels, 4: 0.7, 6: -1.0},
}  # fmt: skip
# All arguments, but for an object that comes first, where nothing of them may be drawn by itself.
WHOLE: dict[str, Callable[[np.random.Generator], list[object]]] = {
    "tp_minimised": problem,
    "tp_reduced": lambda _: reduced(),
    "tp_full_system": lambda _: full_system(),
    **{
        f"tp_{made.__name__}": made
        for made in (
            live.carried_on,
            live.odometry_step,
            live.near_extended,
            live.near_moved,
            live.near_updated,
            live.aligned,
            live.aligned_nearly,
            live.aligned_robustly,
            live.corner_factor,
        )
    },
}
SOUND_SHARE = 0.8
# Inputs that are one sound one, each spoilt in another way but the first.
VARIANTS = 8
MOST_ROWS = 12
MOST_FOUND = 6400
MOST_INDEX = 3


class Made(Struct, frozen=True):
    """Stands for an object of the core of that kind, made anew for each input."""

    kind: type[Handle]


Call = tuple[Kernel, list[object]]


def drawn(kernels: tuple[Kernel, ...], seed: int, number: int) -> list[Call]:
    """The calls of an input, in order."""
    group, variant = divmod(number, VARIANTS)
    calls = [(kernel, list(map(_copy, values))) for kernel, values in _sound(kernels, seed, group)]
    if variant:
        rng = np.random.default_rng((seed, group, variant))
        at = -1 if rng.random() < SOUND_SHARE else int(rng.integers(len(calls)))
        _spoil(rng, calls[at][1])
    return calls


def _copy(value: object) -> object:
    """In memory of just its size, so that the sanitizer sees what lies beside it."""
    return value.copy() if isinstance(value, np.ndarray) else value


@lru_cache(1)
def _sound(kernels: tuple[Kernel, ...], seed: int, group: int) -> list[Call]:
    rng = np.random.default_rng((seed, group))
    kernel = kernels[group % len(kernels)]
    chain = [kernel]
    if name := object_of(kernel):
        names = OBJECTS[name]
        mates = [mate for name in names for mate in kernels if mate.name == name]
        if rng.random() < SOUND_SHARE:
            chain = mates[: mates.index(kernel) + 1]
        else:
            chain = [mates[i] for i in rng.integers(0, len(mates), rng.integers(0, 4))] + chain
    draw = Draw(rng, Scene(rng))
    return [(each, draw.arguments(each)) for each in chain]


def _spoil(rng: np.random.Generator, values: list[object]) -> None:
    """Put what is out of all bounds into some of them."""
    for at in rng.integers(0, len(values), rng.integers(1, 4)).tolist():
        value = values[at]
        if isinstance(value, np.ndarray) and value.size and value.dtype in (float, np.int64):
            poison = POISON if value.dtype == float else POISON_INTS
            where = rng.integers(0, value.size, 1 + value.size // 8)
            is_all = rng.random() < 0.2
            value.reshape(-1)[slice(None) if is_all else where] = rng.choice(poison)
        elif isinstance(value, int):
            values[at] = POISON_INTS[rng.integers(len(POISON_INTS))]
        elif isinstance(value, float):
            values[at] = POISON[rng.integers(len(POISON))]


def _is_free(value: object) -> bool:
    """Whether none of a call's other arguments must be as long: a number's, a picture's."""
    return not isinstance(value, np.ndarray) or value.dtype == np.uint8


class Draw(Struct):
    """Draws arguments about one scene; `lengths`: of the call's letters."""

    rng: np.random.Generator
    scene: Scene
    lengths: dict[str, int] = field(default_factory=dict)

    def arguments(self, kernel: Kernel) -> list[object]:
        """Such as the kernel's declaration lets pass."""
        self.lengths = {}
        if kernel.name in WHOLE and self.rng.random() < SOUND_SHARE:
            first = kernel.parameters[0]
            given = [] if isinstance(first, In) else [self._argument(first)]
            return [*given, *WHOLE[kernel.name](self.rng)]
        values = [self._argument(parameter) for parameter in kernel.parameters]
        if kernel.name in SOUND and self.rng.random() < SOUND_SHARE:
            for at, value in SOUND[kernel.name](self.scene).items():
                if _is_free(values[at]) or np.shape(value) == getattr(values[at], "shape", ()):
                    values[at] = value
        return values

    def _one_of(self, choices: Sequence[T]) -> T:
        return choices[int(self.rng.integers(len(choices)))]

    def _argument(self, parameter: In | type) -> object:
        scene = self.scene
        if isinstance(parameter, In):
            shape = tuple(self._length(axis, parameter) for axis in parameter.shape)
            drawn = self._array(parameter, shape)
            return np.array(np.broadcast_to(drawn, shape), parameter.dtype, order="C")
        if issubclass(parameter, Handle):
            return Made(parameter)
        if parameter is int:
            return int(self._one_of((0, 1, 1, 2, scene.columns, scene.rows, max(scene.size))))
        height, width = scene.size
        return float(self._one_of((0.0, 0.1, 0.5, 1.0, 3.0, -1.0, scene.cell, width, height)))

    def _length(self, axis: int | str, parameter: In) -> int:
        if isinstance(axis, int):
            return axis
        if axis not in self.lengths:
            is_room = (
                parameter.is_written
                and parameter.shape[0] == axis
                and len(parameter.shape) == 2
                and parameter.shape[1] != axis
            )
            length = MOST_FOUND if is_room and self.rng.random() < 0.7 else self._free_length(axis)
            self.lengths[axis] = length
        return self.lengths[axis]

    def _free_length(self, axis: str) -> int:
        rng, known = self.rng, defaultdict(lambda: 1, self.lengths)
        is_sound = rng.random() < 0.9
        if axis in "hw":
            return self.scene.size["hw".index(axis)]
        if axis == "n" and is_sound:
            return self.scene.columns * self.scene.rows
        if axis == "markers" and is_sound:  # of a face
            return known["n"]
        if axis == "p" and is_sound:  # of a lens
            return int(self._one_of((8, 9, 12)))
        if axis == "t" and is_sound:
            return int(self._one_of((0, known["n"])))
        if axis == "s" and is_sound:
            return int(self._one_of((0, 12)))
        if axis == "q" and is_sound:  # unknowns, of which `c` are the derivatives; or any
            return known["c"] // 2 if "c" in known else int(self._one_of((6, 8, 17)))
        if axis == "a" and is_sound:  # of a floor or a room
            return int(self._one_of((2, 3)))
        if axis == "d" and is_sound:  # of a robot's pose
            return int(self._one_of((3, 6)))
        if axis == "f" and is_sound:  # faces
            return MOST_INDEX
        if axis == "c" and is_sound:  # columns of a Jacobian by all that it may have
            return 2 * (known["d"] + 6 + known["p"] + 2 * (known["t"] > 0) + 6 * known["f"])
        longest = 20 * MOST_ROWS if axis == "n" else MOST_ROWS
        return int(rng.integers(0, self._one_of((2, MOST_ROWS, longest))))

    def _array(self, parameter: In, shape: tuple[int, ...]) -> np.ndarray:
        rng, scene = self.rng, self.scene
        if parameter.dtype == np.uint8:
            return scene.picture()
        if parameter.dtype != np.float64:
            return rng.integers(0, 2 if parameter.dtype == np.bool_ else MOST_INDEX, shape)
        if shape[0] == MOST_FOUND:
            return np.zeros(shape)
        if shape == (FIT,):
            return scene.fit
        if len(shape) > 1 and shape[-1] == shape[-2]:
            return np.eye(shape[-1]) + self._one_of((0.0, 0.1)) * rng.normal(size=shape)
        if parameter.shape[0] == "p":
            return np.resize([200.0, 200.0, 50.0, 40.0, 0.1, 0.01, 0.001, 0.0], shape)
        rows = (
            {2: (scene.places, scene.pixels), 5: (scene.grid,)}.get(shape[-1], ())
            if parameter.shape[0] == "n" and len(shape) == 2 and not isinstance(parameter, Out)
            else ()
        )
        if rows and rng.random() < 0.9:
            return np.resize(rows[rng.integers(len(rows))], shape)
        if parameter.shape == ("k", 3):
            return np.resize([scene.columns, scene.rows, 0.0, scene.rows + 1.0, 4.0, 1.0], shape)
        if len(shape) == 1 and rng.random() < 0.5:
            return np.arange(float(shape[0])) if rng.random() < 0.5 else np.ones(shape)
        values = self._one_of((0.0, 0.1, 1.0, 100.0)) * rng.normal(size=shape)
        return values + np.array([0.0, 0.0, 3.0]) if shape[-1:] == (3,) else values
