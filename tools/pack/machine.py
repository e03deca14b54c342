"""What is packed for one machine: its node, the wheel for it, and its end of the bus."""

import os
import re
from pathlib import Path
from typing import Literal

from msgspec import Struct, structs
from msgspec.structs import replace

from trigpoint import __version__
from trigpoint.base.errors import ConfigError, InputError
from trigpoint.contract.access import Kind, identity_in
from trigpoint.edge.sources.frames import STREAMED
from trigpoint.site.config import BusConfig, Site, parse_site
from trigpoint.tools.site.systemd_units import UNITS, Unit

Service = Literal["camera", "robot", "fusion", "recorder", "router"]
"""The kinds of node that run as services."""
_EXTRAS = {Kind.CAMERA: ("edge",), Kind.ROUTER: ()}
"""What of the program is installed where that is not called like the kind."""
_BUS_TABLE = re.compile(r"^\[bus\][^\n]*\n(?:(?!\[).*\n?)*", re.MULTILINE)
_ENDPOINTS = re.compile(
    r"""^(?:connect|listen)\s*=\s*\[(?:[^\]"']|"[^"]*"|'[^']*')*\][^\n]*\n?""", re.MULTILINE
)


class Node(Struct, frozen=True):
    """A node of the site that is to run on a machine of its own."""

    kind: Kind
    name: str

    @classmethod
    def of(cls, site: Site, kind: Kind, name: str) -> "Node":
        """A node of the site file; raises ConfigError or InputError where there is none."""
        identity_in(site, kind, name)
        return cls(kind, name)

    @property
    def unit(self) -> Unit:
        """Its unit for systemd; a router's says its name."""
        [unit] = (unit for unit in UNITS if unit.kind is self.kind)
        if self.kind is Kind.ROUTER:
            return replace(unit, words=f"{unit.words} --name {self.name}")
        return unit

    @property
    def service(self) -> str:
        """What systemd is told to start."""
        return f"{self.unit.name}{self.name}" if self.unit.name.endswith("@") else self.unit.name

    def extras(self, site: Site) -> tuple[str, ...]:
        extras = _EXTRAS.get(self.kind, (self.kind.value,))
        if self.kind is Kind.CAMERA and site.camera(self.name).scheme in STREAMED:
            extras += ("streams",)
        if self.kind is Kind.ROBOT and site.robot(self.name).protocol_name == "mavlink":
            extras += ("mavlink",)
        return extras if site.bus.tls is None else (*extras, "secure")


def site_that_connects(site: Site, endpoint: str) -> Site:
    """The site whose machine connects to `endpoint` and listens nowhere, its file otherwise as it
    is. Raises ConfigError where the endpoint is none, or the file's [bus] is written in a way that
    is not understood here."""
    wanted = _connecting(site.bus, endpoint)
    line = f'connect = ["{endpoint}"]\n'
    found = _BUS_TABLE.search(site.text)
    if found is None:
        text = site.text.rstrip("\n") + f"\n\n[bus]\n{line}"
    else:
        head, _, body = found.group().partition("\n")
        table = f"{head}\n{line}{_ENDPOINTS.sub('', body)}"
        text = site.text[: found.start()] + table + site.text[found.end() :]
    made = parse_site(text, directory=site.directory)
    if made.bus != wanted:
        raise ConfigError(
            "[bus] of the site file cannot be changed here; write connect = "
            f'["{endpoint}"] into it, without listen, and leave --connect out'
        )
    return made


def _connecting(bus: BusConfig, endpoint: str) -> BusConfig:
    try:
        return structs.replace(bus, connect=(endpoint,), listen=())
    except ValueError as reason:
        raise ConfigError(f"--connect: {reason}") from None


def wheel_for(machine: str, given: Path | None, folder: Path) -> Path:
    """The wheel of this version for a machine (`uname -m`): `given`, or in `folder`. Raises
    InputError that says how one is made."""
    if given is not None:
        if not given.is_file() or given.suffix != ".whl":
            raise InputError(f"--wheel {given} is no wheel; give a file that ends in .whl")
        return given
    found = sorted(folder.glob(f"trigpoint-{__version__}-*_{machine}.whl"))
    if not found:
        raise InputError(
            f"{folder} has no wheel of trigpoint {__version__} for {machine}; make it with `make "
            "wheels` in a checkout, or give --wheel FILE"
        )
    return found[-1]


def this_machine() -> str:
    """`uname -m`."""
    return os.uname().machine
