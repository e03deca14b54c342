"""What `doctor` looks at for the robot bridge."""

import importlib.util
import os
from pathlib import Path

from trigpoint.checks import Check


def checks() -> list[Check]:
    """Is the part installed, are there serial ports, and may this user open them?"""
    missing = [name for name in ("serial", "cobs") if importlib.util.find_spec(name) is None]
    if missing:
        remedy = "pip install 'trigpoint[robot]'"
        return [Check("robot", "error", f"{', '.join(missing)} is not installed", remedy)]
    from .port import present_ports

    ports = present_ports()
    if not ports:
        remedy = "plug the robot in; where it has a port of another kind, write its URL in `port`"
        return [Check("serial ports", "warning", "this machine has none", remedy)]
    return [_access(port) for port in ports]


def _access(port: str) -> Check:
    if os.access(port, os.R_OK | os.W_OK):
        return Check("serial port", "ok", f"{port} can be opened by this user")
    remedy = f"add this user to the group «{_group(port)}» (usermod -aG) and log in again"
    return Check("serial port", "error", f"{port} may not be opened by this user", remedy)


def _group(port: str) -> str:
    """The group that owns the port, as Debian names it where it cannot be looked up."""
    try:
        return Path(port).group()
    except (KeyError, OSError):
        return "dialout"
