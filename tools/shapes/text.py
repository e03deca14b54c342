"""target.toml of a target that is made, not written by hand."""

from collections.abc import Iterator, Mapping, Sequence

from msgspec import structs

from trigpoint.site.target import Face, Target
from trigpoint.site.toml_file import said_of, toml_value

_ALWAYS = ("id", "pattern", "columns", "rows", "square", "translation", "quaternion")


def target_text(
    target: Target, *, head: Sequence[str] = (), remarks: Mapping[int, str] | None = None
) -> str:
    """The target as a target file: `head` is its first lines of comment, `remarks` that of each
    face by its id. Reading it gives the target again."""
    lines = [*(f"# {line}" for line in head), f"name = {toml_value(target.name)}"]
    for face in target.faces:
        remark = (remarks or {}).get(face.id)
        lines += ["", f"[[faces]]{f'  # {remark}' if remark else ''}", *_rows(face)]
    return "\n".join(lines) + "\n"


def _rows(face: Face) -> Iterator[str]:
    """Every key that differs from its default, the pose last; of marked boards the first marker
    too, which tells the faces apart."""
    always = _ALWAYS if face.marker is None else (*_ALWAYS, "first_marker")
    said, values = said_of(face), structs.asdict(face)
    pose = {key: values.pop(key) for key in ("translation", "quaternion")}
    for key, value in (values | pose).items():
        if key in always or key in said:
            yield f"{key} = {toml_value(value)}"
