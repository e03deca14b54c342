"""docs/target.md names every key of a target file, whether it is needed, and its default."""

import re
from pathlib import Path

import msgspec
import pytest

from trigpoint.cli import GROUPS
from trigpoint.site.target import Face, Pattern, Target, load_target

PAGE = Path(__file__).parents[4] / "docs" / "target.md"
_AS_KALIBR = ("corner_squares", "tags_turned")
_MARKED = ("marker", "dictionary")


def rows(title: str) -> dict[str, list[str]]:
    """The cells of a table's rows by key, the key's own left out."""
    section = PAGE.read_text(encoding="utf-8").split(f"## {title}\n")[1].split("\n## ")[0]
    found = re.findall(r"^\| `(\w+)` \| (.*) \|$", section, re.MULTILINE)
    return {key: rest.split(" | ") for key, rest in found}


def default_words(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "needed"
    if field.name in _AS_KALIBR:
        return "as Kalibr"
    if field.name in _MARKED:
        return "needed there"
    return f"`{msgspec.json.encode(field.default).decode()}`"


@pytest.mark.parametrize(("title", "struct"), [("The file", Target), ("A face", Face)])
def test_the_page_has_every_key_with_its_default(title: str, struct: type[msgspec.Struct]) -> None:
    fields = msgspec.structs.fields(struct)
    assert {key: cells[-2] for key, cells in rows(title).items()} == {
        field.name: default_words(field) for field in fields
    }


def test_the_page_has_every_pattern_and_the_command_names_it() -> None:
    assert all(f"`{pattern.value}`" in rows("A face")["pattern"][-1] for pattern in Pattern)
    assert PAGE.relative_to(PAGE.parents[1]).as_posix() in GROUPS["target"]


def test_the_pages_example_is_read(tmp_path: Path) -> None:
    example = PAGE.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    (tmp_path / "target.toml").write_text(example, encoding="utf-8")
    assert load_target(tmp_path / "target.toml").face(0).columns == 5
