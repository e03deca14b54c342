"""`trigpoint init`: a first site.toml and target.toml, and units for systemd."""

from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError, OperationError
from trigpoint.site.config import RecorderConfig, load_site, parse_site

from .file import first_site_text, first_target_text, full_site_text
from .systemd_units import SERVICE_USER, SYSUSERS, service_user, unit_files

_UNIT_FOLDER = "/etc/systemd/system"


def main(
    full: Annotated[bool, typer.Option("--full", help="Every key, with its default.")] = False,
    systemd: Annotated[
        bool, typer.Option("--systemd", help="Units for systemd; a site that exists is kept.")
    ] = False,
    camera: Annotated[
        str | None, typer.Option(metavar="SOURCE", help="Where the camera's pictures come from.")
    ] = None,
    robot: Annotated[
        str | None, typer.Option(metavar="PORT", help="What the robot is connected to.")
    ] = None,
    protocol: Annotated[str | None, typer.Option(help="What the robot speaks.")] = None,
    keep_target: Annotated[
        bool, typer.Option("--keep-target", help="Write no target.toml: there is one.")
    ] = False,
    directory: Annotated[Path, typer.Option(help="Where to write them.")] = Path(),
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> None:
    """Write a first site.toml and target.toml that work, to be filled in."""
    if full and not (camera is robot is protocol is None):
        raise InputError("--full writes examples; leave --camera, --robot and --protocol out")
    site = directory / "site.toml"
    texts: dict[Path, str] = {}
    if not (systemd and site.exists()):
        texts[site] = _site_text(camera, robot, protocol, full=full)
        if not keep_target:
            texts[directory / "target.toml"] = first_target_text()
    if systemd:
        texts |= unit_files(directory / "systemd", site, _sessions(site))
    _write(texts, directory, force=force)
    typer.echo(_next_step(site, has_units=systemd))


def _site_text(camera: str | None, robot: str | None, protocol: str | None, *, full: bool) -> str:
    """The site file; raises ConfigError where what was given is not one's."""
    if full:
        return full_site_text()
    text = first_site_text(source=camera, port=robot, protocol=protocol)
    parse_site(text, directory=Path(), file="the site file")
    return text


def _sessions(site: Path) -> Path:
    """The folder to which a site's recorder writes."""
    if not site.exists():
        return site.parent / RecorderConfig().directory
    loaded = load_site(site)
    return loaded.path(loaded.recorder.directory)


def _write(texts: dict[Path, str], directory: Path, *, force: bool) -> None:
    """Write every file or none; raises InputError where one exists that is not to be replaced."""
    for path in texts:
        if path.exists() and not force:
            raise InputError(f"{path} exists already; add --force to replace it")
    try:
        for path, text in texts.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as reason:
        raise OperationError(
            f"{directory}: nothing can be written there ({reason.strerror}); choose another"
        ) from None
    for path in texts:
        typer.echo(f"wrote {path}")


def _next_step(site: Path, *, has_units: bool) -> str:
    look = f"next: edit them, then trigpoint doctor --site {site}"
    if not has_units:
        return look
    loaded = load_site(site)
    units = [f"trigpoint-edge@{name}" for name in loaded.cameras]
    units += [f"trigpoint-robot@{name}" for name in loaded.robots]
    units += [f"trigpoint-{name}" for name in ("fusion", "recorder", "router")]
    user, files = _user_step(site.parent), site.parent / "systemd" / "*.service"
    return (
        f"{look}\n{user}on each machine: sudo cp {files} {_UNIT_FOLDER}/ && "
        "sudo systemctl daemon-reload,\nthen sudo systemctl enable --now what it is to run, of: "
        f"{' '.join(units)}"
    )


def _user_step(folder: Path) -> str:
    """How the service's user comes about, "" where the nodes run as whoever writes the units."""
    if service_user() != SERVICE_USER:
        return ""
    return (
        f"on each machine: sudo systemd-sysusers {folder / 'systemd' / SYSUSERS} && "
        f"sudo chown -R {SERVICE_USER} {folder}\n"
    )
