"""The files of an archive: bytes and modes by their path in it, and the script that installs them:
short, since somebody is to read it before root runs it."""

from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from msgspec import Struct

from trigpoint.base.errors import ConfigError, InputError, read_text
from trigpoint.contract.access import Kind
from trigpoint.recorder.writing.attachments import site_files
from trigpoint.site.config import Site
from trigpoint.tools.site.filled import filled
from trigpoint.tools.site.systemd_units import SERVICE_USER, SYSUSERS, sysusers_text, unit_text

from .machine import Node

PUBLIC, PRIVATE, EXECUTABLE = 0o644, 0o600, 0o755


class Packed(Struct, frozen=True):
    path: str
    data: bytes
    mode: int = PUBLIC


def contents(
    site: Site, node: Node, *, wheel: Path, constraints: Path, machine: str
) -> list[Packed]:
    """Everything that a node's machine needs. Raises InputError, ConfigError or TargetError that
    names what is missing."""
    script = install_script(
        site.name,
        node,
        wheel=wheel.name,
        extras=node.extras(site),
        machine=_machine_of(wheel, machine),
    )
    place = FILES_AT / "site.toml"
    unit = unit_text(
        node.unit,
        place,
        FILES_AT / site.recorder.directory,
        python=str(PROGRAM_AT / "bin/python"),
        user=SERVICE_USER,
    )
    return [
        Packed("install.sh", script.encode(), EXECUTABLE),
        Packed(wheel.name, _bytes(wheel)),
        Packed("constraints.txt", _constraints(constraints)),
        Packed(f"{node.unit.name}.service", unit.encode()),
        Packed(SYSUSERS, sysusers_text(FILES_AT).encode()),
        *_site_files(site, node),
        *_keys(site, node),
    ]


def _machine_of(wheel: Path, machine: str) -> str:
    """Which machine a wheel is for, "" where it is for any."""
    return "" if wheel.stem.endswith("-any") else machine


def _constraints(path: Path) -> bytes:
    remedy = "give --constraints FILE: the one that lies in a checkout"
    return read_text(path, "constraints file", InputError, remedy=remedy).encode()


def _site_files(site: Site, node: Node) -> Iterator[Packed]:
    """The site file and those that it names, where they are beside it."""
    yield Packed("site/site.toml", site.text.encode(), PRIVATE)  # cameras' passwords
    for name, data, _ in site_files(site)[1:]:
        yield Packed(_inside(name), data)
    if node.kind is Kind.ROBOT and (key := site.robot(node.name).mavlink.key) is not None:
        text = read_text(site.path(key), "signing key", ConfigError)
        yield Packed(_inside(key), text.encode(), PRIVATE)


def _inside(name: str) -> str:
    """Where a file that the site names lies in the archive."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise InputError(
            f"{name} lies outside of the site file's folder, so that another machine would not "
            "find it; move it there, and name it by its path from there"
        )
    return f"site/{path}"


def _keys(site: Site, node: Node) -> Iterator[Packed]:
    """What `trigpoint secure` made for the node, and for the machine where it listens."""
    if site.bus.tls is None:
        return
    from trigpoint.security import credentials

    held = [credentials.node_credentials(site, node.kind, node.name)]
    if site.bus.listen and node.kind is not Kind.ROUTER:
        held.append(credentials.router_credentials(site))
    place = _inside(site.bus.tls.directory)
    yield Packed(f"{place}/{credentials.TRUST}", _bytes(held[0].trust))
    for one in held:
        yield Packed(f"{place}/{one.key.name}", _bytes(one.key), PRIVATE)
        yield Packed(f"{place}/{one.certificate.name}", _bytes(one.certificate))
    if node.kind in (Kind.ROBOT, Kind.FUSION):
        signed = credentials.directory(site) / credentials.CORRECTIONS
        credentials.load_public_key(signed)
        yield Packed(f"{place}/{signed.name}", _bytes(signed))


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as reason:
        raise InputError(
            f"{path} cannot be read ({reason.strerror}); see that it is there"
        ) from None


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
