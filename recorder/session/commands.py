"""The commands `info`, `check` and `recover`."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.clock import NANOSECONDS, to_ns, to_seconds
from trigpoint.base.errors import InputError
from trigpoint.base.terminal import table
from trigpoint.base.words import numberless
from trigpoint.recorder.mcap.check import check as check_file
from trigpoint.recorder.mcap.index import read_index

from .files import faults, parts_of, spans
from .info import KeyInfo, info_json, info_lines, session_info
from .recording import Recording, open_recording
from .recover import recover as save_sound

Session = Annotated[Path, typer.Argument(help="An .mcap file, or a folder with a session.")]

_SHOWN = 20


def info(
    session: Session,
    json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    at: Annotated[
        str,
        typer.Option(
            metavar='"2026-11-20 14:05"',
            help="In which file of a folder of recordings a moment is; local time, unless it says "
            "otherwise (…Z, …+01:00).",
        ),
    ] = "",
) -> None:
    """What is in a recording: keys with their types, rates, gaps and losses."""
    if at and json:
        raise InputError("--at says where a moment is in one line a file; leave --json out")
    if at:
        _say_where(session, at)
        return
    found = session_info(open_recording(session))
    if json:
        typer.echo(info_json(found))
        return
    for line in info_lines(found):
        typer.echo(line)
    keys = sorted(found.keys.items())
    head = ("key", "messages", "Hz", "gap s", "lost", "breaks", "type")
    rows = [_row(key, one) for key, one in keys]
    colours = ["red" if one.lost or one.sequence_breaks else "" for _, one in keys]
    typer.echo(table(head, rows, left=(0, 6), colours=colours))


def _say_where(folder: Path, at: str) -> None:
    """Say in which files a moment is, and how long after their beginning; status 1 for none."""
    try:
        moment = datetime.fromisoformat(at).astimezone()
    except ValueError:
        raise InputError(f"--at {at}: this is no time; write one like 2026-11-20 14:05") from None
    known, at_ns = spans(folder), to_ns(moment.timestamp())
    if not known:
        raise InputError(f"{folder}: there is no recording in this folder; check the path")
    found = [span for span in known if span[1] <= at_ns <= span[2]]
    for file, first_ns, last_ns in found:
        after_s = to_seconds(at_ns - first_ns)
        typer.echo(
            f"{file}: {_clock(first_ns)} to {_clock(last_ns)}; {after_s:.0f} s after its start"
        )
    if found:
        return
    before = [span for span in known if span[2] < at_ns]
    after = [span for span in known if span[1] > at_ns]
    near = (
        [f"the last before it ends at {_clock(before[-1][2])} ({before[-1][0]})"] if before else []
    )
    near += [f"the first after it begins at {_clock(after[0][1])} ({after[0][0]})"] if after else []
    typer.echo(f"no recording has {_clock(at_ns)}: {'; '.join(near)}", err=True)
    raise typer.Exit(1)


def _clock(stamp_ns: int) -> str:
    """A moment in local time."""
    moment = datetime.fromtimestamp(stamp_ns // NANOSECONDS, UTC).astimezone()
    return moment.isoformat(sep=" ")


def check(session: Session) -> None:
    """Is a recording sound? Every rule of the MCAP format, strict order of log times included.

    Ends with status 1 where it is not.
    """
    parts = parts_of(session)
    lacking = faults(parts)
    for file, fault in lacking.items():
        typer.echo(f"{file}: error: {fault}")
    is_sound = not lacking
    files = [file for file in parts if file not in lacking]
    for file in files:
        verdict = check_file(file)
        is_sound = is_sound and verdict.is_sound
        kinds = {"error": verdict.errors, "warning": verdict.warnings, "note": verdict.remarks}
        for kind, texts in kinds.items():
            alike = _alike(texts)
            for text in alike[:_SHOWN]:
                typer.echo(f"{file}: {kind}: {text}")
            if len(alike) > _SHOWN:
                typer.echo(f"{file}: and {len(alike) - _SHOWN} more kinds of {kind}s")
        if verdict.is_sound:
            typer.echo(f"{file}: sound")
    if not is_sound:
        some = files and Recording([read_index(file) for file in files]).counts
        kept = "`trigpoint recover` saves what is sound of a damaged recording"
        typer.echo(kept if some else "no message in it is whole; copy or record it anew", err=True)
        raise typer.Exit(1)


def recover(
    session: Session,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mcap", help="Without it: beside the file, in recovered/."),
    ] = None,
) -> None:
    """Save what is sound of a damaged recording into a new file; it also makes one of parts."""
    recording = open_recording(session)
    folder = session if session.is_dir() else session.parent
    file = out or folder / "recovered" / f"{recording.name}.mcap"
    if file.suffix != ".mcap":
        raise InputError(f"{file}: a recording's name ends in .mcap; write another --out")
    if file.exists():
        raise InputError(f"{file}: is there already; write another --out")
    counts = save_sound(recording, file)
    for key, count in counts.items():
        typer.echo(f"{count:8d}  {key}")
    typer.echo(f"{sum(counts.values()):8d}  messages saved: {file}")


def _alike(texts: Sequence[str]) -> list[str]:
    """One for all that differ in numbers alone, with how many there are."""
    kinds: dict[str, list[str]] = {}
    for text in texts:
        kinds.setdefault(numberless(text), []).append(text)
    return [
        first + (f" (and {len(more)} more like it)" if more else "")
        for first, *more in kinds.values()
    ]


def _row(key: str, one: KeyInfo) -> tuple[str, ...]:
    numbers = (f"{one.rate_hz:.1f}", f"{one.longest_gap_s:.2f}", str(one.lost))
    return (key, str(one.messages), *numbers, str(one.sequence_breaks), one.type)
