"""The border to the compiled core: no array crosses it unchecked.

A `Kernel` is one function of the library with the types and shapes of what it takes. A call has
them checked (`packing.cpp`), so that nothing can be read or written outside of an array; the
interpreter's lock is released while the core works, and what goes wrong there comes back as an
error.
"""

import ctypes
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar
from weakref import finalize

import numpy as np
from msgspec import Struct

LIBRARY = Path(__file__).with_name("libtrigpoint_core.so")
_ERROR = ctypes.c_char * 256  # as ERROR_BYTES of `border.hpp`
_NO_MEMORY = -2
# As `trigpoint::Argument` of `border.hpp` and `Parameter` of `packing.cpp`.
_ARGUMENT_BYTES = 32
_PARAMETER = struct.Struct("=icbbb3q")
_ARRAY, _WHOLE, _NUMBER, _OBJECT = range(4)
_MOST_LETTERS = 24
_KINDS = {"f": b"f", "i": b"i", "u": b"u", "b": b"?"}
# The functions of CPython that `packing.cpp` calls, in its order.
_PYTHON = (
    *("PyTuple_GetItem", "PyObject_GetBuffer", "PyBuffer_Release", "PyFloat_AsDouble"),
    *("PyLong_AsLongLong", "PyErr_Occurred", "PyErr_Clear", "PyObject_IsInstance"),
)


class In(Struct, frozen=True):
    """An array that is read: its type, and its shape; a letter for a length that is free, the same
    wherever the letter is the same."""

    dtype: type
    shape: tuple[int | str, ...]
    is_written: ClassVar[bool] = False


class Out(In, frozen=True):
    """An array that is written, of the caller."""

    is_written: ClassVar[bool] = True


class Kernel:
    """One function of the core. Its parameters in order: `In`, `Out`, or `int`, `float` for a
    number, or a kind of `Handle` for an object of the core."""

    def __init__(self, name: str, *parameters: In | type) -> None:
        self.name = name
        self.parameters = parameters
        self._handles = [
            (row, kind)
            for row, kind in enumerate(parameters)
            if isinstance(kind, type) and issubclass(kind, Handle)
        ]
        letters: dict[str, int] = {}
        self._layout = b"".join(_packed(parameter, letters) for parameter in parameters)
        self._arguments = ctypes.c_char * (_ARGUMENT_BYTES * len(parameters))
        assert len(letters) <= _MOST_LETTERS, name

    def __reduce__(self) -> tuple[object, ...]:
        return Kernel, (self.name, *self.parameters)

    def __call__(self, *values: object) -> int:
        """What the function counts, 0 or more.

        Raises TypeError or ValueError where an argument is not as declared, MemoryError,
        RuntimeError with the core's own words.
        """
        if len(values) != len(self.parameters):
            raise TypeError(f"{self.name} takes {len(self.parameters)} arguments")
        given = self._with_addresses(values) if self._handles else values
        arguments, error = self._arguments(), _ERROR()
        pack, python = _packing()
        fault = pack(given, self._layout, len(values), python, arguments)
        if fault:
            raise self._refusal(values, *divmod(fault, 8))
        count = _function(self.name)(arguments, error)
        if count >= 0:
            return count
        text = error.value.decode(errors="replace")
        raise MemoryError(text) if count == _NO_MEMORY else RuntimeError(f"{self.name}: {text}")

    def _with_addresses(self, values: tuple[object, ...]) -> tuple[object, ...]:
        """The values with the address of each object of the core in its place."""
        given = list(values)
        for row, kind in self._handles:
            value = given[row]
            if not isinstance(value, kind):
                raise self._refusal(values, row, 1)
            given[row] = value.address
        return tuple(given)

    def _refusal(self, values: tuple[object, ...], row: int, fault: int) -> Exception:
        """Why a value is not taken; `fault`: of `packing.cpp`."""
        value, wanted = values[row], self.parameters[row]
        kind = getattr(value, "dtype", type(value).__name__)
        if not isinstance(wanted, In):
            return TypeError(f"{self.name} takes {wanted.__name__}, not {kind}")
        if fault == 1:
            return TypeError(f"{self.name} takes {wanted.dtype.__name__} arrays, not {kind}")
        why = {
            2: f"takes shape {wanted.shape}, not {np.shape(value)}",  # pyright: ignore
            3: "takes arrays that lie in one piece",
            4: "writes to an array that is read-only",
        }
        return ValueError(f"{self.name} {why[fault]}")


def _packed(parameter: In | type, letters: dict[str, int]) -> bytes:
    """A parameter as `packing.cpp` reads it; `letters`: the number of each so far."""
    if isinstance(parameter, In):
        native = np.dtype(parameter.dtype)
        axes = [
            -1 - letters.setdefault(axis, len(letters)) if isinstance(axis, str) else axis
            for axis in parameter.shape
        ]
        axes += [0] * (3 - len(axes))
        sizes = native.itemsize, len(parameter.shape), parameter.is_written
        return _PARAMETER.pack(_ARRAY, _KINDS[native.kind], *sizes, *axes)
    kind = {int: _WHOLE, float: _NUMBER}.get(parameter, _OBJECT)
    return _PARAMETER.pack(kind, b"?", 0, 0, 0, 0, 0, 0)


class Handle:
    """An object of the core, freed with this one; for one thread at a time. Each kind is a class of
    its own, by which kernels take it; `name`: of its two functions `…_new` and `…_free`."""

    name: ClassVar[str]

    def __init__(self) -> None:
        made = ctypes.c_void_p()
        new = _function(f"{self.name}_new")
        if new(ctypes.byref(made), _ERROR()):
            raise MemoryError(f"{self.name}: no memory is left")
        self.address = made.value
        finalize(self, _function(f"{self.name}_free"), made, None)

    def __reduce__(self) -> tuple[object, ...]:
        raise TypeError(f"{self.name} is the core's, in this process: it is not copied or sent")


_MAKE = "run `make core` in a checkout, or install Trigpoint again"


@cache
def _function(name: str) -> Callable[..., int]:
    """A function of the library; it is called without the interpreter's lock."""
    return _found(_library(ctypes.CDLL), name)


@cache
def _packing() -> tuple[Callable[..., int], ctypes.Array[ctypes.c_void_p]]:
    """`trigpoint_pack`, which is called with the interpreter's lock held; and what it calls."""
    pack = _found(_library(ctypes.PyDLL), "trigpoint_pack")
    address, number = ctypes.c_void_p, ctypes.c_int64
    pack.argtypes = (ctypes.py_object, ctypes.c_char_p, number, address, address)
    functions = [ctypes.cast(getattr(ctypes.pythonapi, name), address) for name in _PYTHON]
    return pack, (address * (len(functions) + 1))(*functions, id(np.ndarray))


def _found(library: ctypes.CDLL, name: str) -> Any:
    try:
        function = library[name]
    except AttributeError as error:
        raise ImportError(f"the compiled core is another version ({error}); {_MAKE}") from error
    function.restype = ctypes.c_int64
    return function


@cache
def _library(kind: type[ctypes.CDLL]) -> ctypes.CDLL:
    try:
        return kind(str(LIBRARY))
    except OSError as error:
        raise ImportError(f"the compiled core cannot be loaded ({error}); {_MAKE}") from error
