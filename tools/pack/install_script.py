"""The script that an archive is installed by: short, since somebody is to read it before root runs
it."""

from collections.abc import Sequence
from pathlib import Path

from .machine import Node

PROGRAM_AT = Path("/opt/trigpoint")
FILES_AT = Path("/var/lib/trigpoint")
_UNITS_AT = Path("/etc/systemd/system")


def install_script(
    site: str, node: Node, *, wheel: str, extras: Sequence[str], machine: str
) -> str:
    """A POSIX shell script; `machine`: what `uname -m` must say, "" for any."""
    wanted = f"./{wheel}[{','.join(extras)}]" if extras else f"./{wheel}"
    return f"""\
#!/bin/sh
# Installs {node.role} {node.name} of site {site} on this machine:
#     sudo sh install.sh
# Into a folder, to see what it does, without root, user or service:
#     DESTDIR=/tmp/try sh install.sh
set -eu
cd "$(dirname "$0")"
root=${{DESTDIR:-}}
program=$root{PROGRAM_AT}
files=$root{FILES_AT}
units=$root{_UNITS_AT}

stop() {{
    echo "install.sh: $1" >&2
    exit 1
}}

[ -n "$root" ] || [ "$(id -u)" = 0 ] || stop "needs root: sudo sh install.sh"
{_machine_check(machine)}python3 -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' ||
    stop "needs Python 3.11 or later: apt install python3-venv"

echo "1 the program, from the wheel here; what it needs comes from your package index: $program"
python3 -m venv "$program"
pip() {{ "$program/bin/pip" install --quiet --disable-pip-version-check "$@"; }}
pip -c constraints.txt '{wanted}'
pip --force-reinstall --no-deps ./{wheel}  # where another of the same version was

echo "2 the site's files and this machine's keys: $files"
mkdir -p "$files"
cp -Rp site/. "$files"
chmod 700 "$files"

echo "3 the unit: $units/{node.unit.name}.service"
mkdir -p "$units"
cp {node.unit.name}.service "$units"

if [ -n "$root" ]; then
    echo "not done in a folder: the user, the service"
    exit 0
fi

echo "4 the user and the service: {node.service}"
systemd-sysusers "$PWD/trigpoint.conf"
chown -R trigpoint: "$files"
systemctl daemon-reload
systemctl enable {node.service}
systemctl restart {node.service}
echo "done; what it says: journalctl -fu {node.service}"
"""


def _machine_check(machine: str) -> str:
    if not machine:
        return ""
    return f"""\
[ "$(uname -m)" = {machine} ] ||
    stop "this archive is for {machine}; pack one with --machine $(uname -m)"
"""
