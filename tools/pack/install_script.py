"""The script that an archive is installed by: short, since somebody is to read it before root runs
it."""

from collections.abc import Sequence
from pathlib import Path

from trigpoint.tools.site.filled import filled

from .machine import Node

PROGRAM_AT = Path("/opt/trigpoint")
FILES_AT = Path("/var/lib/trigpoint")
_SCRIPT = Path(__file__).with_name("install.sh")


def install_script(
    site: str, node: Node, *, wheel: str, extras: Sequence[str], machine: str
) -> str:
    """A POSIX shell script; `machine`: what `uname -m` must say, "" for any."""
    return filled(
        _SCRIPT,
        role=node.kind.value,
        name=node.name,
        site=site,
        program_at=str(PROGRAM_AT),
        files_at=str(FILES_AT),
        wheel=wheel,
        extras=f"[{','.join(extras)}]" if extras else "",
        unit=node.unit.name,
        service=node.service,
        machine_check=_machine_check(machine) if machine else "",
    )


def _machine_check(machine: str) -> str:
    return f"""\
[ "$(uname -m)" = {machine} ] ||
    stop "this archive is for {machine}; pack one with --machine $(uname -m)\""""
