"""TOML files read into frozen msgspec structs, errors naming file, line and key; and written."""

import json
import math
import re
import tomllib
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from trigpoint.base.errors import InputError, read_text
from trigpoint.base.words import nearest

Struct = TypeVar("Struct", bound=msgspec.Struct)
KeyPath = tuple[str | int, ...]
_KALIBR = re.compile(r"(?m)^target_type:")
_IMPORT = (
    "this is Kalibr's target file; make one of it: trigpoint target import FILE --out target.toml"
)


def parse_toml(
    text: str,
    struct: type[Struct],
    file: str,
    error: type[InputError],
    settings: Mapping[str, object] | None = None,
) -> Struct:
    """The struct in TOML `text`; raise `error` with «file:line: what, what to do». `settings`:
    dotted keys to values that stand in place of the text's."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as reason:
        what = _IMPORT if _KALIBR.search(text) else f"not valid TOML: {reason}; mend that line"
        raise error(f"{file}: {what}") from None
    for key, value in (settings or {}).items():
        _put(document, key, value, error)
    lines = text.splitlines()
    try:
        return _convert(document, struct, ())
    except _Problem as problem:
        line = _line_of(lines, problem.path)
        where = f"{file}:{line}" if line else file
        raise error(f"{where}: {_dotted(problem.path)}{problem.text}") from None


def checked(document: object, struct: type[Struct], file: str, error: type[InputError]) -> Struct:
    """The struct in a document of another format; raise `error` with «file: what, what to do»."""
    try:
        return _convert(document, struct, ())
    except _Problem as problem:
        raise error(f"{file}: {_dotted(problem.path)}{problem.text}") from None


def load_toml(path: Path, struct: type[Struct], kind: str, error: type[InputError]) -> Struct:
    """The struct in a TOML file; `kind`: what messages call the file («site file»)."""
    return parse_toml(read_text(path, kind, error), struct, str(path), error)


def toml_value(value: object) -> str:
    """A value as TOML writes it; JSON writes strings, numbers, booleans and lists the same way."""
    return json.dumps(value, ensure_ascii=False)


def toml_table(name: str, values: Mapping[str, object]) -> list[str]:
    """The lines of a table, and an empty one."""
    return [f"[{name}]", *(f"{key} = {toml_value(value)}" for key, value in values.items()), ""]


def said_of(struct: msgspec.Struct) -> dict[str, object]:
    """The keys of a struct whose values are not the defaults."""
    usual = {field.name: field.default for field in msgspec.structs.fields(type(struct))}
    values = msgspec.structs.asdict(struct)
    return {key: value for key, value in values.items() if value != usual[key]}


def _put(document: dict[str, Any], key: str, value: object, error: type[InputError]) -> None:
    *tables, last = key.split(".")
    for name in tables:
        document = document.setdefault(name, {})
        if not isinstance(document, dict):
            raise error(f"the setting «{key}»: «{name}» is no table; write its keys as in the file")
    document[last] = value


class _Problem(Exception):
    def __init__(self, path: KeyPath, text: str) -> None:
        super().__init__(text)
        self.path, self.text = path, text


def _convert(value: Any, kind: Any, path: KeyPath) -> Any:
    """Like msgspec.convert, but level by level, so that the path of a problem is known."""
    kind = _without_none(kind)
    origin = get_origin(kind)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return _convert_struct(value, kind, path)
    if origin is dict and isinstance(value, dict):
        inner = get_args(kind)[1]
        return {key: _convert(item, inner, (*path, key)) for key, item in value.items()}
    if origin is tuple and isinstance(value, list) and _holds_structs(kind):
        inner = get_args(kind)[0]
        return tuple(_convert(item, inner, (*path, i)) for i, item in enumerate(value))
    try:
        found = msgspec.convert(value, kind)
    except msgspec.ValidationError as reason:
        if choices := _choices(kind):
            text = f": «{value}» is none of {', '.join(choices)}{nearest(str(value), choices)}"
            raise _Problem(path, text) from None
        raise _Problem(path, f": {_plain(reason)}; correct it") from None
    for number in found if isinstance(found, tuple) else [found]:
        if isinstance(number, float) and not math.isfinite(number):
            raise _Problem(path, f" is {number}; write a finite number")
    return found


def _choices(kind: Any) -> list[str]:
    """The words that a closed choice accepts; none for other types."""
    if get_origin(kind) is Literal:
        return [str(choice) for choice in get_args(kind)]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return [str(choice.value) for choice in kind]
    return []


def _convert_struct(value: Any, struct: type[msgspec.Struct], path: KeyPath) -> msgspec.Struct:
    if not isinstance(value, dict):
        raise _Problem(path, " must be a table")
    kinds = get_type_hints(struct, include_extras=True)
    known = {field.encode_name: field for field in msgspec.structs.fields(struct)}
    for key in value:
        if key not in known:
            raise _Problem((*path, key), f" is not a known key{nearest(key, known)}")
    for key, field in known.items():
        if field.required and key not in value:
            raise _Problem(path, f"{' ' if path else ''}needs the key «{key}»; add it")
    names = {key: known[key].name for key in value}
    fields = {name: _convert(value[key], kinds[name], (*path, key)) for key, name in names.items()}
    try:
        return struct(**fields)
    except ValueError as reason:
        raise _Problem(path, f"{': ' if path else ''}{reason}") from None


def _without_none(kind: Any) -> Any:
    if get_origin(kind) in (Union, UnionType):
        others = [argument for argument in get_args(kind) if argument is not type(None)]
        if len(others) == 1:
            return others[0]
    return kind


def _holds_structs(kind: Any) -> bool:
    inner = get_args(kind)[0]
    return isinstance(inner, type) and issubclass(inner, msgspec.Struct)


def _plain(reason: msgspec.ValidationError) -> str:
    text = (
        str(reason)
        .replace("`", "«", 1)
        .replace("`", "»", 1)
        .replace("`", "«", 1)
        .replace("`", "»", 1)
    )
    return text[0].lower() + text[1:]


def _dotted(path: KeyPath) -> str:
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in path]
    return "".join(parts).lstrip(".")


def _line_of(lines: list[str], path: KeyPath) -> int | None:
    """The line number (from 1) of a path, or of the nearest table above it."""
    here: KeyPath = ()
    counters: dict[KeyPath, int] = {}
    best, depth = None, 0
    for number, line in enumerate(lines, start=1):
        if table := re.match(r"\s*(\[\[?)([^\[\]]+)\]", line):
            here = _names(table[2])
            if table[1] == "[[":
                counters[here] = counters.get(here, -1) + 1
            here = _numbered(here, counters)
            found = here
        elif key := re.match(r"\s*([\w.\"'-]+)\s*=", line):
            found = (*here, *_names(key[1]))
        else:
            continue
        shared = 0
        while shared < min(len(found), len(path)) and found[shared] == path[shared]:
            shared += 1
        if shared > depth and shared == min(len(found), len(path)):
            best, depth = number, shared
    return best


def _names(dotted: str) -> KeyPath:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


def _numbered(table: KeyPath, counters: dict[KeyPath, int]) -> KeyPath:
    for length in range(len(table), 0, -1):
        if table[:length] in counters:
            return (*table[:length], counters[table[:length]], *table[length:])
    return table
