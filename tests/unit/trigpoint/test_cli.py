import ast
import errno
import logging
import os
import re
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

import pytest
import typer
from support.commands import Cli

import trigpoint
from trigpoint import __version__
from trigpoint.base.errors import BusError, ConfigError
from trigpoint.cli import (
    COMMANDS,
    EXTRAS,
    GROUPS,
    Command,
    chosen_command,
    log_level_in_front,
    run,
)

ROOT = Path(trigpoint.__file__).resolve().parents[1]


def put_command(monkeypatch: pytest.MonkeyPatch, function: object, name: str = "edge") -> None:
    """Make `trigpoint NAME` run `function`."""
    module = ModuleType("pretended")
    module.__dict__["main"] = function
    monkeypatch.setitem(sys.modules, "pretended", module)
    extra = COMMANDS[name].extra
    monkeypatch.setitem(COMMANDS, name, Command("pretended:main", "Pretends.", extra))


def test_version_is_printed(cli: Cli) -> None:
    assert cli("--version").out == f"trigpoint {__version__}\n"


def test_help_lists_every_command_without_importing_one() -> None:
    code = "import sys; from trigpoint.cli import run; run(['--help']); print(*sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    listing, _, modules = result.stdout.rstrip().rpartition("\n")
    for name, command in COMMANDS.items():
        group = name.split()[0]
        shown, text = (group, GROUPS[group]) if group in GROUPS else (name, command.help)
        assert re.search(rf"^  {shown} +{re.escape(text)}", listing, re.MULTILINE)
    heavy = {"numpy", "zenoh", "cv2", "msgspec", "trigpoint.node.node", "trigpoint.bus.bus"}
    assert heavy.isdisjoint(modules.split())


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_of_the_table_opens(name: str, cli: Cli) -> None:
    function = COMMANDS[name].load()
    assert function.__doc__
    out = " ".join(cli(*name.split(), "--help").out.split())
    assert f"Usage: trigpoint {name}" in out
    assert function.__doc__.split()[0] in out


def test_every_plug_in_opens() -> None:
    for entry in entry_points(group="trigpoint.frames"):
        assert callable(entry.load())


def test_log_level_may_stand_anywhere(monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    put_command(monkeypatch, lambda: None)
    cli("edge", "--log-level", "debug")
    assert logging.getLogger("trigpoint").level == logging.DEBUG
    assert "loud" in cli.refused("edge", "--log-level", "loud")


def test_shell_completes_commands_and_the_options_of_one() -> None:
    def completed(line: str) -> list[str]:
        words = line.split(" ")
        environment = os.environ | {
            "_TRIGPOINT_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(words) - 1),
        }
        command = [sys.executable, "-c", "from trigpoint.cli import main; main()"]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True
        ).stdout.split()

    assert {"review", "replay", "record"} <= set(completed("trigpoint re"))
    assert "--watch" in completed("trigpoint status --")


@pytest.mark.parametrize(
    ("number", "status"),
    [
        *((errno.ENAMETOOLONG, 2), (errno.EACCES, 2), (errno.ELOOP, 2)),
        *((errno.EROFS, 1), (errno.ENOSPC, 1), (errno.EMFILE, 1), (errno.ENODEV, 1)),
    ],
)
def test_a_file_that_the_system_refuses_is_one_line(
    number: int, status: int, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def refused() -> None:
        raise OSError(number, os.strerror(number), "/a/session")

    put_command(monkeypatch, refused)
    words = os.strerror(number)
    said = cli("edge", status=status)
    begin = f"trigpoint: /a/session: {words[0].lower()}{words[1:]}; check the path"
    assert (said.out, said.err[: len(begin)], said.err.count("\n")) == ("", begin, 1)


def test_a_name_that_is_no_command_is_said(cli: Cli) -> None:
    assert "No such command" in cli.refused("conquer")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("edge --site a", "edge"),
        ("--log-level debug edge", "edge"),
        ("edge --site a --log-level=debug", "edge"),
        ("review demo", "review"),
        ("review edge --save demo", "review"),
        ("target draw a.toml", "target draw"),
        ("target", ""),
        ("--help", ""),
        ("", ""),
    ],
)
def test_chosen_command_is_read_off_the_line(arguments: str, expected: str) -> None:
    assert chosen_command(log_level_in_front(arguments.split())) == expected


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["--nonsense"], ["target"], ["status", "--site"]]
)
def test_bad_use_is_one_line_and_exits_2(arguments: list[str], cli: Cli) -> None:
    captured = cli(*arguments, status=2)
    assert captured.out == ""
    assert re.fullmatch(r"trigpoint: .+; see `trigpoint.*--help`\n", captured.err)


def test_a_site_file_is_the_one_of_this_folder_or_of_the_environment(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "site.toml: there is no such site file; give --site FILE" in cli.refused("status")
    monkeypatch.setenv("TRIGPOINT_SITE", "hall.toml")
    assert "hall.toml: there is no such site file" in cli.refused("status")


def test_no_command_at_all_shows_the_help_and_exits_2(cli: Cli) -> None:
    assert "Commands:" in cli(status=2).out


@pytest.mark.parametrize(("error", "status"), [(ConfigError, 2), (BusError, 1)])
def test_error_on_purpose_is_one_line_with_its_status(
    monkeypatch: pytest.MonkeyPatch,
    cli: Cli,
    error: type[Exception],
    status: int,
) -> None:
    def fail() -> None:
        raise error("site.toml:3: no;\nmend it")

    put_command(monkeypatch, fail)
    assert cli("edge", status=status).err == "trigpoint: site.toml:3: no; mend it\n"


@pytest.mark.parametrize("package", list(EXTRAS))
@pytest.mark.parametrize("command", ["edge", "board", "calibrate"])
def test_missing_extra_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch, cli: Cli, package: str, command: str
) -> None:
    """The command's own extra where that has the package: a bag that an agent's machine opens
    takes the recorder's."""

    def fail() -> None:
        raise ModuleNotFoundError(f"No module named '{package}.x'", name=f"{package}.x")

    own = COMMANDS[command].extra
    has_it = set(own.split(",")) & set(EXTRAS[package])
    extra = own if has_it else EXTRAS[package][0]
    put_command(monkeypatch, fail, command)
    assert cli(command, status=1).err == (
        f"trigpoint: `trigpoint {command}` needs the package «{package}», which is not installed "
        f"here; run: pip install -c constraints.txt 'trigpoint[{extra}] @ "
        f"file:///path/to/trigpoint-{trigpoint.__version__}-py3-none-manylinux_2_28_"
        f"{os.uname().machine}.whl'\n"
    )


def test_extras_are_those_that_the_project_declares() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {"PIL": "pillow", "cv2": "opencv-python-headless", "serial": "pyserial"}
    for package in ("PIL", "av", "cryptography", "cv2", "mcap", "serial"):
        wanted = names.get(package, package)
        has_it = {
            extra
            for extra, needs in declared["optional-dependencies"].items()
            if any(re.split(r"[>=<]", need)[0] == wanted for need in needs)
        }
        assert set(EXTRAS[package]) == has_it, package


def test_every_package_that_may_be_missing_is_known() -> None:
    """Else whoever installed less than all of it gets a traceback."""
    source = Path(trigpoint.__file__).parents[1]
    parts = ("trigpoint", "edge", "fusion", "robot", "recorder", "tools")
    modules = [path for part in parts for path in (source / part).rglob("*.py")]
    always = {"trigpoint", "zenoh", "msgspec", "numpy", "rosbags", "ruamel", "rich", "typer"}
    always.add("prometheus_client")
    always.add("pymavlink")  # its own protocol says that it is missing
    known = {"trigpoint", *always, *sys.stdlib_module_names, *EXTRAS}
    assert len(modules) > 100
    for path in modules:
        text = path.read_text(encoding="utf-8")
        if set(_FIRST_WORD.findall(text)) - known:  # or a line of a text that begins so
            assert set(_imported(ast.parse(text))) <= known, path


_FIRST_WORD = re.compile(r"^ *(?:from|import) +(\w+)", re.MULTILINE)


def _imported(tree: ast.AST) -> Iterator[str]:
    """The top packages that a module imports, at its head or in a function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            yield node.module.partition(".")[0]


def test_a_camera_node_needs_the_edge_extra_alone() -> None:
    """Its commands, and what `doctor` looks at there."""
    others = [name for name, extras in EXTRAS.items() if "edge" not in extras]
    places = [row.place.partition(":")[0] for row in COMMANDS.values() if row.extra == "edge"]
    places.append("trigpoint.tools.doctor.cameras")
    assert "trigpoint.tools.pictures.detect" in places
    blocked = f"import sys; sys.modules.update(dict.fromkeys({others}))"
    code = "\n".join([blocked, *(f"import {place}" for place in places)])
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr


def test_a_module_of_ours_that_is_missing_is_no_missing_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise ModuleNotFoundError("No module named 'trigpoint.x'", name="trigpoint.x")

    put_command(monkeypatch, fail)
    with pytest.raises(ModuleNotFoundError):
        run(["edge"])


def test_a_mistake_in_the_program_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    put_command(monkeypatch, fail)
    with pytest.raises(ZeroDivisionError):
        run(["edge"])


def test_interruption_exits_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    put_command(monkeypatch, interrupt)
    assert run(["edge"]) == 130


def test_a_commands_own_status_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise typer.Exit(1)

    put_command(monkeypatch, fail)
    assert run(["edge"]) == 1


def test_sigterm_unwinds_a_command_that_is_no_service(monkeypatch: pytest.MonkeyPatch) -> None:
    unwound: list[bool] = []

    def terminated() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            unwound.append(True)

    put_command(monkeypatch, terminated)
    monkeypatch.setitem(COMMANDS, "edge", Command("pretended:main", "Pretends."))
    with pytest.raises(SystemExit) as caught:
        run(["edge"])
    assert caught.value.code == 143
    assert unwound == [True]


def test_reader_that_goes_away_is_no_error_to_speak_of(tmp_path: Path) -> None:
    command = f"{sys.executable} -m trigpoint --help | true"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert result.stderr == ""


def test_module_runs_as_the_program() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "trigpoint", "--version"], capture_output=True, text=True, check=True
    )
    assert result.stdout == f"trigpoint {__version__}\n"
