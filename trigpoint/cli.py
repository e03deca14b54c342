"""The program: a table of commands; only the chosen one is imported."""

import errno
import gc
import importlib
import itertools
import logging
import os
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Annotated, NamedTuple, NoReturn

import typer

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import MissingExtraError, TrigpointError
from trigpoint.base.words import install_command

from . import __version__
from .base import log

PROGRAM = "trigpoint"
_LOG_LEVEL = "--log-level"
_COMPLETE = f"_{PROGRAM.upper()}_COMPLETE"


class Command(NamedTuple):
    """One row. `place`: «module:function»; `extra`: the extra that it needs; a `service` runs until
    it is told to stop, so that a stop counts as success."""

    place: str
    help: str
    extra: str = ""
    service: bool = False

    def load(self) -> Callable[..., None]:
        """Import the function."""
        module, _, function = self.place.partition(":")
        return getattr(importlib.import_module(module), function)


COMMANDS: dict[str, Command] = {
    "demo": Command(
        "trigpoint.tools.demo.command:main", "The whole system around a simulated lab.", "all"
    ),
    "start": Command(
        "trigpoint.tools.start.command:main", "Asks what you have, and goes on with it.", "all"
    ),
    "up": Command(
        "trigpoint.tools.up.command:main", "All parts of this machine: one log, one stop.", "all"
    ),
    "init": Command("trigpoint.tools.site.init:main", "Write a first site.toml and target.toml."),
    "doctor": Command("trigpoint.tools.doctor.command:main", "Say what is wrong on this machine."),
    "status": Command("trigpoint.tools.site.status:main", "Show the live site."),
    "board": Command(
        "trigpoint.tools.board.command:main",
        "A web page of the live site, and all its metrics.",
        "board",
        service=True,
    ),
    "look": Command(
        "trigpoint.tools.look.command:main",
        "What a camera sees, and its lens, without a site file.",
        "edge,board",
        service=True,
    ),
    "edge": Command(
        "trigpoint.edge.command:main", "The agent of one or several cameras.", "edge", service=True
    ),
    "robot": Command(
        "trigpoint.robot.command:main", "The serial bridge of one robot.", "robot", service=True
    ),
    "fusion": Command(
        "trigpoint.fusion.command:main", "The live estimator.", "fusion", service=True
    ),
    "record": Command(
        "trigpoint.recorder.commands:record", "Record the site to MCAP.", "recorder", service=True
    ),
    "view": Command(
        "trigpoint.recorder.commands:view", "The live site in rerun.", "recorder", service=True
    ),
    "review": Command(
        "trigpoint.recorder.commands:review", "A recorded session in rerun.", "recorder"
    ),
    "replay": Command(
        "trigpoint.recorder.commands:replay", "Put a session back on the bus.", "recorder"
    ),
    "info": Command(
        "trigpoint.recorder.session.commands:info", "What is in a recording.", "recorder"
    ),
    "check": Command(
        "trigpoint.recorder.session.commands:check", "Is a recording sound?", "recorder"
    ),
    "recover": Command(
        "trigpoint.recorder.session.commands:recover",
        "Save what is sound of a damaged recording.",
        "recorder",
    ),
    "export": Command(
        "trigpoint.recorder.export.file:main",
        "A session in the formats of other tools.",
        "recorder",
    ),
    "calibrate": Command(
        "trigpoint.tools.calibrate.command:main", "The estimator over a session.", "fusion,recorder"
    ),
    "distances": Command(
        "trigpoint.tools.networks.distances:main",
        "Distances between cameras, beside a tape measure's.",
    ),
    "coverage": Command(
        "trigpoint.tools.coverage.command:main",
        "How well robots are corrected where.",
        "fusion,recorder",
    ),
    "detect": Command("trigpoint.tools.pictures.detect:main", "The sightings in pictures.", "edge"),
    "intrinsics": Command(
        "trigpoint.tools.pictures.intrinsics:main", "One camera's intrinsics from pictures.", "edge"
    ),
    "target make": Command(
        "trigpoint.tools.target.make:make",
        "A target file with its poses, and its print.",
        "edge,tools",
    ),
    "target draw": Command(
        "trigpoint.tools.target.files:draw", "A printable target at true scale.", "edge,tools"
    ),
    "target check": Command(
        "trigpoint.tools.target.files:check", "What is wrong with a target file.", "edge"
    ),
    "target import": Command(
        "trigpoint.tools.target.files:import_kalibr", "A target file from Kalibr's.", "edge"
    ),
    "router": Command(
        "trigpoint.tools.secure.router:main",
        "Join the machines and segments of a site.",
        service=True,
    ),
    "secure init": Command(
        "trigpoint.tools.secure.command:init", "Make the site's authority.", "secure"
    ),
    "secure node": Command(
        "trigpoint.tools.secure.command:node", "One node's key and certificate.", "secure"
    ),
    "secure list": Command(
        "trigpoint.tools.secure.command:list_nodes", "Who may come in, and until when.", "secure"
    ),
    "secure renew": Command(
        "trigpoint.tools.secure.command:renew", "Prolong a node's certificate.", "secure"
    ),
    "secure revoke": Command(
        "trigpoint.tools.secure.command:revoke", "End a certificate.", "secure"
    ),
    "secure admit": Command(
        "trigpoint.tools.secure.command:admit", "Trust another site's router.", "secure"
    ),
    "secure router": Command(
        "trigpoint.tools.secure.command:router", "The configuration of a stock zenohd.", "secure"
    ),
    "pack": Command(
        "trigpoint.tools.pack.command:main",
        "One archive for a machine.",
        "recorder",
    ),
    "simulate": Command(
        "trigpoint.tools.simulation.command:main",
        "A session of a simulated lab, with its truth.",
        "all",
    ),
    "simulate robot": Command(
        "trigpoint.tools.simulation.command:robot",
        "A live robot and a site of sim:// cameras.",
        "all",
        service=True,
    ),
}

GROUPS = {
    "target": "Target files; their keys: docs/reference/target.md.",
    "secure": "Certificates of a site's nodes, and who may come in.",
}

EXTRAS: dict[str, tuple[str, ...]] = {
    "PIL": ("recorder", "board"),
    "av": ("streams",),
    "cryptography": ("secure",),
    "cv2": ("edge", "fusion"),
    "isal": ("recorder",),
    "lz4": ("recorder",),
    "mcap": ("recorder",),
    "pyarrow": ("recorder",),
    "reportlab": ("tools",),
    "rerun": ("recorder",),
    "rerun_cli": ("recorder",),
    "serial": ("robot",),
    "starlette": ("board",),
    "uvicorn": ("board",),
    "zstandard": ("recorder",),
}
"""Package -> the extras that install it; the first, unless another is the command's own."""


def main() -> NoReturn:
    """Entry point of the program `trigpoint`."""
    ENDING.guard()
    gc.disable()  # until the command is there: `_keep_what_is_loaded`
    try:
        status = run(sys.argv[1:])
    except SystemExit as reason:
        status = reason.code if isinstance(reason.code, int) else int(reason.code is not None)
    except BaseException:  # noqa: BLE001 - told as Python would, then left as any other end
        traceback.print_exc()
        status = 1
    ENDING.leave(status)


def run(arguments: Sequence[str]) -> int:
    """Run one command line; return its exit status."""
    # Our matrices are small: BLAS threads only hinder each other and other processes. This must
    # be set before numpy is loaded, so before any command is.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = log_level_in_front(arguments)
    chosen = chosen_command(_completed(os.environ) or arguments)
    _listen_for_stops(chosen)
    try:
        loaded = program(chosen)
        _keep_what_is_loaded()
        status = loaded(
            args=_in_one_word(arguments, chosen) or ["--help"],
            prog_name=PROGRAM,
            standalone_mode=False,
        )
    except TrigpointError as error:
        return _fail(str(error), error.exit_status)
    except typer.TyperException as error:
        shown = " ".join(filter(None, [PROGRAM, chosen, "--help"]))
        return _fail(f"{error.format_message().rstrip('.')}; see `{shown}`", 2)
    except ModuleNotFoundError as error:
        extra = COMMANDS[chosen].extra if chosen else ""
        missing = missing_extra(error, f"{PROGRAM} {chosen}", extra)
        if missing is None:
            raise
        return _fail(str(missing), missing.exit_status)
    except OSError as error:
        if not (error.filename and error.strerror):
            raise
        logging.getLogger(__name__).debug("where it was", exc_info=True)
        wrong = f"{error.filename}: {error.strerror[:1].lower()}{error.strerror[1:]}"
        status = 2 if error.errno in _GIVEN_WRONG else 1
        return _fail(f"{wrong}; check the path, its rights and its disk", status)
    except typer.Abort:
        return 130
    if not arguments:
        return 2
    return status if isinstance(status, int) else 0


def _keep_what_is_loaded() -> None:
    """Spare what was imported the search for unreachable cycles: it stays until the program ends,
    and to look through it takes a tenth of a short command's time. Only in a process that is ours
    from the start, where `main` put off the search."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def chosen_command(arguments: Sequence[str]) -> str:
    """The command that a line's first words name, "" if none."""
    words = list(itertools.dropwhile(lambda word: word.startswith("-"), arguments))
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in COMMANDS:
            return name
    return ""


def log_level_in_front(arguments: Sequence[str]) -> list[str]:
    """The line with `--log-level`, which may be given anywhere, moved before the command and joined
    to its value."""
    front, rest, words = [], [], iter(arguments)
    for word in words:
        if word == "--":
            return [*front, *rest, word, *words]
        if word == _LOG_LEVEL:
            value = next(words, None)
            front.append(word if value is None else f"{word}={value}")
        elif word.startswith(f"{_LOG_LEVEL}="):
            front.append(word)
        else:
            rest.append(word)
    return [*front, *rest]


def _in_one_word(arguments: Sequence[str], chosen: str) -> list[str]:
    """The line, with `simulate robot` as one word: beside `simulate WORLD` it cannot be a group."""
    first, _, second = chosen.partition(" ")
    words = list(arguments)
    if second and first not in GROUPS:
        begin = words.index(first)
        words[begin : begin + 2] = [chosen]
    return words


def program(chosen: str) -> typer.Typer:
    """The program with the chosen command loaded; the others are only names with a help line."""
    settings = {
        "rich_markup_mode": None,
        "pretty_exceptions_enable": False,
    }
    app = typer.Typer(help="Survey the cameras of a building by driving a robot.", **settings)
    app.callback()(_options)
    groups = {
        name: typer.Typer(help=text, add_completion=False, **settings)
        for name, text in GROUPS.items()
    }
    for name, command in COMMANDS.items():
        group, _, last = name.rpartition(" ")
        function = command.load() if name == chosen else _placeholder
        summary = None if name == chosen else command.help
        place, word = (groups[group], last) if group in groups else (app, name)
        place.command(word, help=summary)(function)
    for name, group in groups.items():
        app.add_typer(group, name=name)
    return app


def _completed(environment: Mapping[str, str]) -> list[str]:
    """The words of a line that a shell wants completed, without the program's name; else empty."""
    if _COMPLETE not in environment:
        return []
    line = environment.get("_TYPER_COMPLETE_ARGS") or environment.get("COMP_WORDS", "")
    return line.split()[1:]


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo(f"{PROGRAM} {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", is_eager=True, callback=_print_version
        ),
    ] = False,
    log_level: Annotated[
        log.Level, typer.Option(help="Least level of the log lines on standard error.")
    ] = log.Level.INFO,
) -> None:
    del version  # the callback has done the work
    log.set_up(log_level)


def _placeholder() -> None:
    raise AssertionError("a command was run that was not loaded")


def _listen_for_stops(chosen: str) -> None:
    """Have a service end in order on SIGTERM and SIGINT, which are its normal end.

    Any other command is cut short: SIGTERM unwinds like an error, so that everything is closed.
    """

    def unwind(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    if chosen and COMMANDS[chosen].service:
        ENDING.listen()
    else:
        signal.signal(signal.SIGTERM, unwind)


def missing_extra(error: ModuleNotFoundError, user: str, extra: str) -> MissingExtraError | None:
    """The message for a third-party package that `user` lacks, and the extra that has it, which is
    `extra` (or several, with commas) where that does; None for any other import error."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    if not set(extra.split(",")) & set(EXTRAS[package]):
        extra = EXTRAS[package][0]
    return MissingExtraError(
        f"`{user}` needs the package «{package}», which is not installed here; "
        f"run: {install_command(extra)}"
    )


_GIVEN_WRONG = {errno.ENOENT, errno.EACCES, errno.EPERM, errno.EEXIST, errno.ENAMETOOLONG}
_GIVEN_WRONG |= {errno.ENOTDIR, errno.EISDIR, errno.ELOOP}
"""What another path mends. All else may be well when a service is started again."""


def _fail(text: str, status: int) -> int:
    typer.echo(f"{PROGRAM}: {' '.join(text.split())}", err=True)
    return status
