"""Inputs for the kernels: calls that were made, as they were and spoilt.

An input is one kernel's call, with the calls before it of its object. It depends on the corpus, the
seed and its number alone.
"""

import numpy as np
from msgspec import Struct

from trigpoint.native.library import Handle, In, Kernel

POISON = (
    np.nan, np.inf, -np.inf, 1e300, -1e300, 1e18, -1e18, 3e9, -3e9, 1e-300, -1.0, 0.0, 0.5, 1e4,
)  # fmt: skip
POISON_INTS = (-1, 0, 1, 5, 1000, 2**31 - 1, -(2**31), 2**62, -(2**63), 2**63 - 1)
# Inputs that are the same calls, each spoilt in another way but the first.
VARIANTS = 8
_LAST_SHARE, _CUT_SHARE, _ODD_SHARE = 0.8, 0.4, 0.2
_MOST_ROWS = 12


class Made(Struct, frozen=True):
    """Stands for an object of the core of that kind, made anew for each input."""

    kind: type[Handle]


Call = tuple[Kernel, list[object]]
Corpus = dict[str, list[list[Call]]]
"""By the kernel's name: calls of it, each behind some before it of the same object."""


def drawn(kernels: tuple[Kernel, ...], corpus: Corpus, seed: int, number: int) -> list[Call]:
    """The calls of an input, in order."""
    group, variant = divmod(number, VARIANTS)
    rng = np.random.default_rng((seed, group))
    kernel = kernels[group % len(kernels)]
    known = corpus.get(kernel.name, ())
    # Now and then a call by itself, or one that nobody has made: by the declaration alone.
    if not known or rng.random() < _ODD_SHARE / 2:
        chain = [(kernel, _declared(rng, kernel))]
    else:
        chain = known[int(rng.integers(len(known)))]
        chain = chain[-1:] if rng.random() < _ODD_SHARE / 2 else chain
    calls = [(each, list(map(_copy, values))) for each, values in chain]
    if variant:
        rng = np.random.default_rng((seed, group, variant))
        at = -1 if rng.random() < _LAST_SHARE else int(rng.integers(len(calls)))
        if rng.random() < _CUT_SHARE:
            _cut(rng, *calls[at])
        if rng.random() >= _CUT_SHARE / 2:
            _spoil(rng, calls[at][1])
        if rng.random() < _ODD_SHARE:
            _misfit(rng, calls[at][1])
    return calls


def _copy(value: object) -> object:
    """In memory of just its size, so that the sanitizer sees what lies beside it."""
    return value.copy() if isinstance(value, np.ndarray) else value


def _declared(rng: np.random.Generator, kernel: Kernel) -> list[object]:
    """Arguments that the declaration lets pass."""
    lengths: dict[str, int] = {}

    def argument(parameter: In | type) -> object:
        if not isinstance(parameter, In):
            is_object = issubclass(parameter, Handle)
            return Made(parameter) if is_object else parameter(rng.integers(0, 3))
        shape = tuple(
            lengths.setdefault(axis, int(rng.integers(0, _MOST_ROWS)))
            if isinstance(axis, str)
            else axis
            for axis in parameter.shape
        )
        is_real = parameter.dtype is np.float64
        drawn = rng.normal(size=shape) if is_real else rng.integers(0, 3, shape)
        return drawn.astype(parameter.dtype)

    return [argument(parameter) for parameter in kernel.parameters]


def _cut(rng: np.random.Generator, kernel: Kernel, values: list[object]) -> None:
    """Give one of the lengths that are free another value: rows are left out, or come again."""
    places = [
        (name, at, axis)
        for at, parameter in enumerate(kernel.parameters)
        for axis, name in enumerate(parameter.shape if isinstance(parameter, In) else ())
        if isinstance(name, str)
    ]
    if not places:
        return
    letter, first, along = places[rng.integers(len(places))]
    old = np.asarray(values[first]).shape[along]
    length = max(0, int(rng.choice([0, 1, old // 2, old - 1, old + 1, 2 * old])))
    for name, at, axis in places:
        if name == letter:
            rows = np.arange(length) % max(old, 1)
            there = np.asarray(values[at])
            there = np.take(there, rows, axis) if old else _none(there, axis, length)
            values[at] = np.ascontiguousarray(there)


def _none(array: np.ndarray, axis: int, length: int) -> np.ndarray:
    return np.zeros((*array.shape[:axis], length, *array.shape[axis + 1 :]), array.dtype)


def _spoil(rng: np.random.Generator, values: list[object]) -> None:
    """Put what is out of all bounds into some of them."""
    for at in rng.integers(0, len(values), rng.integers(1, 4)).tolist():
        value = values[at]
        if isinstance(value, np.ndarray) and value.size:
            own = value.reshape(-1)
            known = own[rng.integers(value.size)]  # twice, or the number beside it
            ints = (*POISON_INTS, known, known ^ 1) if own.dtype == np.int64 else (0, 1)
            poison = (*POISON, known) if own.dtype == float else ints
            where = rng.integers(0, value.size, 1 + value.size // 8)
            is_all = rng.random() < 0.2
            own[slice(None) if is_all else where] = rng.choice(poison)
        elif isinstance(value, int):
            values[at] = POISON_INTS[rng.integers(len(POISON_INTS))]
        elif isinstance(value, float):
            values[at] = POISON[rng.integers(len(POISON))]


def _misfit(rng: np.random.Generator, values: list[object]) -> None:
    """Put what the declaration does not let pass, or hardly, in place of one of them."""
    at = int(rng.integers(len(values)))
    value = values[at]
    others: list[object] = [None, "", [0.0], values[rng.integers(len(values))]]
    if isinstance(value, np.ndarray):
        read_only = value.copy()
        read_only.flags.writeable = False
        kind = (np.float32, np.int32, np.uint8, object, ">f8")[rng.integers(5)]
        others += [np.zeros(value.shape, kind), read_only, value.T, value[None], value[..., :0]]
        others += [np.repeat(value, 2, -1)[..., ::2] if value.ndim else value, value[:-1].copy()]
    values[at] = others[rng.integers(len(others))]
