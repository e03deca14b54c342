"""The border to the compiled core: every array that crosses it is checked here.

A `Kernel` is one function of the library with the types and shapes of what it takes. A call checks
them, so that nothing can be read or written outside of an array; the interpreter's lock is released
while the core works, and what goes wrong there comes back as an error.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from struct import Struct
from typing import ClassVar
from weakref import finalize

import numpy as np

LIBRARY = Path(__file__).with_name("libtrigpoint_core.so")
_ERROR_BYTES = 256
_NO_MEMORY = -2
# As `trigpoint::Argument` of `border.hpp`: an array's address and shape, or a number.
_ARRAY, _INT, _FLOAT, _HANDLE = (Struct(form) for form in ("Pqqq", "q24x", "d24x", "P24x"))


@dataclass(frozen=True, slots=True)
class In:
    """An array that is read: its type, and its shape; a letter for a length that is free, the same
    wherever the letter is the same."""

    dtype: type
    shape: tuple[int | str, ...]
    is_written: ClassVar[bool] = False
    native: np.dtype = field(init=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "native", np.dtype(self.dtype))


@dataclass(frozen=True, slots=True)
class Out(In):
    """An array that is written, of the caller."""

    is_written: ClassVar[bool] = True


class Kernel:
    """One function of the core. Its parameters in order: `In`, `Out`, or `int`, `float` for a
    number, or a kind of `Handle` for an object of the core."""

    def __init__(self, name: str, *parameters: In | type) -> None:
        self.name = name
        self.parameters = parameters

    def __call__(self, *values: object) -> int:
        """What the function counts, 0 or more.

        Raises TypeError or ValueError where an argument is not as declared, MemoryError,
        RuntimeError with the core's own words.
        """
        if len(values) != len(self.parameters):
            raise TypeError(f"{self.name} takes {len(self.parameters)} arguments")
        lengths: dict[str, int] = {}
        arguments = b"".join(
            [
                self._packed(value, parameter, lengths)
                for value, parameter in zip(values, self.parameters, strict=True)
            ]
        )
        error = ctypes.create_string_buffer(_ERROR_BYTES)
        count = _function(self.name)(arguments, error)
        if count >= 0:
            return count
        text = error.value.decode(errors="replace")
        raise MemoryError(text) if count == _NO_MEMORY else RuntimeError(f"{self.name}: {text}")

    def _packed(self, value: object, parameter: In | type, lengths: dict[str, int]) -> bytes:
        if isinstance(parameter, In):
            return self._packed_array(value, parameter, lengths)
        if parameter is float and isinstance(value, int | float | np.floating):
            return _FLOAT.pack(value)
        if parameter is int and isinstance(value, int | np.integer):
            return _INT.pack(value)
        if issubclass(parameter, Handle) and isinstance(value, parameter):
            return _HANDLE.pack(value.address)
        raise TypeError(f"{self.name} takes {parameter.__name__}, not {type(value).__name__}")

    def _packed_array(self, value: object, parameter: In, lengths: dict[str, int]) -> bytes:
        if not isinstance(value, np.ndarray):
            kind = type(value).__name__
            raise TypeError(f"{self.name} takes {parameter.dtype.__name__} arrays, not {kind}")
        dtype, shape, flags = value.dtype, value.shape, value.flags
        # Nearly always the same object: `==` of two types of numbers takes longer than all else.
        if dtype is not parameter.native and dtype != parameter.native:
            raise TypeError(f"{self.name} takes {parameter.dtype.__name__} arrays, not {dtype}")
        if not _is_fit(shape, parameter.shape, lengths):
            raise ValueError(f"{self.name} takes shape {parameter.shape}, not {shape}")
        if not flags.c_contiguous or not flags.aligned:
            raise ValueError(f"{self.name} takes arrays that lie in one piece")
        if parameter.is_written and not flags.writeable:
            raise ValueError(f"{self.name} writes to an array that is read-only")
        if flags.writeable and 0 not in shape:  # a quarter of the other's time
            address = ctypes.addressof(ctypes.c_char.from_buffer(value))  # pyright: ignore
        else:
            address = value.__array_interface__["data"][0]
        return _ARRAY.pack(address, *shape, *(0, 0, 0)[len(shape) :])


def _is_fit(
    shape: tuple[int, ...], expected: tuple[int | str, ...], lengths: dict[str, int]
) -> bool:
    """Whether a shape is the expected one; `lengths`: of the letters so far."""
    if len(shape) != len(expected):
        return False
    for axis, length in zip(expected, shape, strict=True):
        if length != (axis if axis.__class__ is int else lengths.setdefault(axis, length)):  # pyright: ignore
            return False
    return True


class Handle:
    """An object of the core, freed with this one; for one thread at a time. Each kind is a class of
    its own, by which kernels take it; `name`: of its two functions `…_new` and `…_free`."""

    name: ClassVar[str]

    def __init__(self) -> None:
        made = ctypes.c_void_p()
        new = _function(f"{self.name}_new")
        if new(ctypes.byref(made), ctypes.create_string_buffer(_ERROR_BYTES)):
            raise MemoryError(f"{self.name}: no memory is left")
        self.address = made.value
        finalize(self, _function(f"{self.name}_free"), made, None)


_MAKE = "run `make core` in a checkout, or install Trigpoint again"


@cache
def _function(name: str) -> Callable[..., int]:
    """A function of the library; it is called without the interpreter's lock."""
    try:
        function = _library()[name]
    except AttributeError as error:
        raise ImportError(f"the compiled core is another version ({error}); {_MAKE}") from error
    function.restype = ctypes.c_int64
    return function


@cache
def _library() -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(LIBRARY))
    except OSError as error:
        raise ImportError(f"the compiled core cannot be loaded ({error}); {_MAKE}") from error
