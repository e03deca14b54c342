"""What `doctor` looks at for the robot bridge."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from trigpoint.base.checks import Check
from trigpoint.base.errors import PortError

if TYPE_CHECKING:
    from .line.guess import Guess


def checks() -> list[Check]:
    """Are there serial ports, and may this user open them?"""
    from .line.guess import guessed
    from .line.port import present_ports

    ports = present_ports()
    if not ports:
        remedy = "plug the robot in; where it has a port of another kind, write its URL in `port`"
        return [Check("serial ports", "warning", "this machine has none", remedy)]
    return [_access(port, guessed) for port in ports]


def _access(port: str, guessed: "Callable[[str], Guess | None]") -> Check:
    if os.access(port, os.R_OK | os.W_OK):
        return _speaker(port, guessed)
    remedy = f"add this user to the group «{_group(port)}» (usermod -aG) and log in again"
    return Check("serial port", "error", f"{port} may not be opened by this user", remedy)


def _speaker(port: str, guessed: "Callable[[str], Guess | None]") -> Check:
    """Who answers at a port that may be opened."""
    try:
        found = guessed(port)
    except PortError as reason:
        return Check("serial port", "ok", f"{port} is in use ({reason})")
    if found is None:
        remedy = "switch the robot on; what speaks at another speed is not found"
        text = f"{port} can be opened; nobody answers in a protocol that is known here"
        return Check("serial port", "ok", text, remedy)
    lines = f'port = "{port}", baud = {found.baud}, protocol = "{found.protocol}"'
    return Check("serial port", "ok", f"{found.who} answers; write {lines}")


def _group(port: str) -> str:
    """The group that owns the port, as Debian names it where it cannot be looked up."""
    try:
        return Path(port).group()
    except (KeyError, OSError):
        return "dialout"
