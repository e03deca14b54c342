"""The reference names everything that there is, and nothing else."""

import math
import re
import typing
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import typer.main
from msgspec import Struct
from typer.core import TyperGroup

from trigpoint import cli
from trigpoint.contract.access import GRANTS, Kind
from trigpoint.contract.topics import TOPICS, Topic
from trigpoint.site.config.site import SiteFile
from trigpoint.site.target import Face, Pattern, Target, load_target

ROOT = Path(__file__).parents[3]
REFERENCE = ROOT / "docs/reference"
_NODES = {Kind.CAMERA: "edge", Kind.ROBOT: "robot", Kind.FUSION: "fusion"}


def text(page: str) -> str:
    return (REFERENCE / page).read_text(encoding="utf-8")


def rows(page: str, title: str) -> dict[str, list[str]]:
    """The cells of a section's rows by what the first one names in code, that one left out."""
    section = text(page).split(f"## {title}\n")[1].split("\n## ")[0]
    found = re.findall(r"^\| `(.+?)` \| (.*) \|$", section, re.MULTILINE)
    return {key: rest.split(" | ") for key, rest in found}


def tables(kind: object, name: str) -> Iterator[tuple[str, type[Struct]]]:
    """Every table below a type in the site file, by its header."""
    if isinstance(kind, type) and issubclass(kind, Struct):
        yield name, kind
        for field in msgspec.structs.fields(kind):
            yield from tables(field.type, f"{name}.{field.name}".lstrip("."))
    for part in typing.get_args(kind):
        yield from tables(part, f"{name}.NAME" if typing.get_origin(kind) is dict else name)


def default_words(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "needed"
    if field.default is None:
        return "–"
    if isinstance(field.default, float) and math.isnan(field.default):
        return "by source"
    return f"`{msgspec.json.encode(field.default).decode()}`"


@pytest.mark.parametrize(("name", "struct"), list(tables(SiteFile, "")))
def test_the_site_page_has_every_key_with_its_default(name: str, struct: type[Struct]) -> None:
    fields = [
        field for field in msgspec.structs.fields(struct) if not list(tables(field.type, "table"))
    ]
    found = rows("site.md", f"[{name}]" if name else "The file")
    assert {key: cells[0] for key, cells in found.items()} == {
        field.name: default_words(field) for field in fields
    }


def test_the_site_page_has_no_table_that_is_gone() -> None:
    headers = re.findall(r"^## \[(.+)\]$", text("site.md"), re.MULTILINE)
    assert sorted(headers) == sorted(name for name, _ in tables(SiteFile, "") if name)


@pytest.mark.parametrize(("title", "struct"), [("The file", Target), ("A face", Face)])
def test_the_target_page_has_every_key_with_its_default(title: str, struct: type[Struct]) -> None:
    special = {"corner_squares": "as Kalibr", "tags_turned": "as Kalibr"}
    special |= {"marker": "needed there", "dictionary": "needed there"}
    assert {key: cells[-2] for key, cells in rows("target.md", title).items()} == {
        field.name: special.get(field.name) or default_words(field)
        for field in msgspec.structs.fields(struct)
    }


def test_the_target_page_has_every_pattern_and_the_command_names_it() -> None:
    patterns = rows("target.md", "A face")["pattern"][-1]
    assert all(f"`{pattern.value}`" in patterns for pattern in Pattern)
    assert "docs/reference/target.md" in cli.GROUPS["target"]


def test_the_target_pages_example_is_read(tmp_path: Path) -> None:
    example = text("target.md").split("```toml\n")[1].split("```")[0]
    (tmp_path / "target.toml").write_text(example, encoding="utf-8")
    assert load_target(tmp_path / "target.toml").face(0).columns == 5


def sender(topic: Topic) -> str:
    kinds = [kind for kind, grants in GRANTS.items() if topic in grants.publishes]
    return ", ".join(_NODES[kind] for kind in kinds) if len(kinds) == 1 else "every node"


def test_the_page_of_keys_is_the_contracts() -> None:
    assert rows("keys.md", "Topics") == {
        topic.path: [topic.type_name, sender(topic), topic.delivery.value, str(topic.cache or "–")]
        for topic in TOPICS
    }
    served = {path for grants in GRANTS.values() for path in grants.serves}
    assert set(rows("keys.md", "Commands")) == served


def test_the_page_of_keys_has_our_own_messages_as_they_are() -> None:
    for path in (ROOT / "tools/ros2/trigpoint_msgs/msg").glob("*.msg"):
        definition = path.read_text(encoding="utf-8").rstrip()
        assert f"# trigpoint_msgs/msg/{path.stem}\n{definition}\n" in text("keys.md")


def command_row(name: str) -> str:
    """A command's row, as its own help has it."""
    group, _, last = name.rpartition(" ")
    program = typer.main.get_command(cli.program(name))
    assert isinstance(program, TyperGroup)
    command = program.commands[group if group in cli.GROUPS else name]
    if isinstance(command, TyperGroup):
        command = command.commands[last]
    words, options = [name], []
    for parameter in command.params:
        if parameter.param_type_name == "option":
            options.append(f"`{parameter.opts[0]}`")
        else:
            word = parameter.human_readable_name.upper() + "…" * (parameter.nargs < 0)
            words.append(word if parameter.required else f"[{word}]")
    row = cli.COMMANDS[name]
    cells = [f"`{' '.join(words)}`", row.help, " ".join(options), row.extra.replace(",", ", ")]
    return f"| {' | '.join(cell or '–' for cell in cells)} |"


def test_the_page_of_commands_is_the_programs() -> None:
    found = re.findall(r"^\| `.*\|$", text("commands.md"), re.MULTILINE)
    assert found == [command_row(name) for name in cli.COMMANDS]
