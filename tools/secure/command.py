"""`trigpoint secure`: a site's authority, its nodes' certificates, and who may come in."""

import json as json_text
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import writing
from trigpoint.bus.settings import router_settings
from trigpoint.contract.access import Kind, identity_in
from trigpoint.security.credentials import CORRECTIONS, TRUST, WARNING, door
from trigpoint.site.config import load_site
from trigpoint.site.option import SITE_FILE, SiteFile

from .authority import Authority, Listed, addresses_of

Folder = Annotated[
    Path | None,
    typer.Option("--authority", help="The authority's folder; beside the site file if not given."),
]
KindOf = Annotated[Kind, typer.Argument(help="What the node is.")]
NameOf = Annotated[str, typer.Argument(metavar="ID", help="Its name; a camera's in the site file.")]
Addresses = Annotated[
    list[str] | None,
    typer.Option(help="Where a router is connected to: an IP address or a host's name."),
]
Days = Annotated[int, typer.Option(help="How long the certificate is good.", min=1, max=3650)]
_YEAR = 365


def init(site: SiteFile = SITE_FILE, authority: Folder = None) -> None:
    """Make the site's authority. Its folder stays with whoever admits nodes, off the network."""
    loaded = load_site(site)
    made = Authority.of(loaded, authority)
    made.create()
    typer.echo(
        f"made the authority of site {loaded.name} in {made.folder}: keep it off the network"
    )
    if loaded.bus.tls is None:
        typer.echo(f"next: write [bus.tls] into {site}, and tls/… where [bus] connects and listens")
    typer.echo(
        "then: trigpoint secure node KIND ID for every node, a router's for each that listens"
    )


def node(
    kind: KindOf,
    name: NameOf,
    site: SiteFile = SITE_FILE,
    authority: Folder = None,
    days: Days = _YEAR,
    address: Addresses = None,
) -> None:
    """Make one node's key and certificate, and let it in."""
    loaded = load_site(site)
    identity = identity_in(loaded, kind, name)
    addresses = addresses_of(kind, address or ())
    found = Authority.of(loaded, authority)
    files = found.issue(identity, days, addresses)
    typer.echo(f"{identity.common_name} may come in for {days} days")
    typer.echo(f"to its machine, 0600 and its owner's: {' '.join(str(path) for path in files)}")
    public = [TRUST, CORRECTIONS] if kind is Kind.FUSION else [TRUST]
    names = " and ".join(str(found.given / name) for name in public)
    typer.echo(f"to every machine that listens, and to this one: {names}")


def renew(
    kind: KindOf,
    name: NameOf,
    site: SiteFile = SITE_FILE,
    authority: Folder = None,
    days: Days = _YEAR,
    address: Addresses = None,
) -> None:
    """Prolong a node's certificate; its key stays, and no other machine needs to be told.

    A router that is to be reached elsewhere gets all its addresses anew by --address.
    """
    loaded = load_site(site)
    identity = identity_in(loaded, kind, name, is_known=True)
    addresses = addresses_of(kind, address) if address else ()
    file = Authority.of(loaded, authority).renew(identity, days, addresses)
    typer.echo(f"{identity.common_name} is good for {days} days; copy {file} to its machine")


def revoke(
    kind: KindOf, name: NameOf, site: SiteFile = SITE_FILE, authority: Folder = None
) -> None:
    """End a node's certificate before its time."""
    loaded = load_site(site)
    identity = identity_in(loaded, kind, name, is_known=True)
    found = Authority.of(loaded, authority)
    found.revoke(identity)
    typer.echo(f"{identity.common_name} is out once every machine that listens has {found.trust}")


def admit(
    anchor: Annotated[Path, typer.Argument(help="The router's anchor, from its authority.")],
    site: SiteFile = SITE_FILE,
    authority: Folder = None,
) -> None:
    """Trust another site's router to hand this site's keys on."""
    loaded = load_site(site)
    found = Authority.of(loaded, authority)
    identity = found.admit(anchor)
    typer.echo(f"{identity.common_name} may hand on site {loaded.name}; copy {found.trust}")


def list_nodes(
    site: SiteFile = SITE_FILE,
    authority: Folder = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON list.")] = False,
) -> None:
    """Who may come in, until when, and who was revoked; exit 1 where a certificate ran out."""
    loaded = load_site(site)
    found = Authority.of(loaded, authority)
    nodes, strangers = found.listed(), found.strangers()
    if json:
        rows = [_row(one) for one in nodes] + [
            {"name": one, "state": "stranger"} for one in strangers
        ]
        typer.echo(json_text.dumps(rows))
    else:
        for one in nodes:
            row = _row(one)
            reached = f", reached at {row['addresses']}" if row["addresses"] else ""
            typer.echo(f"{row['state']:9} {row['until'][:10]}  {row['name']}{reached}")
        for name in strangers:
            typer.echo(f"stranger              «{name}» is in {found.trust}; was it put there?")
    if strangers or any(_state(one) == "expired" for one in nodes):
        raise typer.Exit(1)


def router(
    site: SiteFile = SITE_FILE,
    out: Annotated[Path, typer.Option(help="Where to write it.")] = Path("router.json5"),
) -> None:
    """Write the configuration with which the stock `zenohd` is this site's router."""
    loaded = load_site(site)
    rate = loaded.router.picture_rate
    entry = door(loaded) if loaded.bus.tls else None
    settings = router_settings(loaded.name, loaded.bus, entry, picture_rate=rate)
    with writing(out):
        out.write_text(json_text.dumps(settings.document(), indent=2) + "\n", encoding="utf-8")
    typer.echo(f"wrote {out}; run `zenohd -c {out}`, and again after every change of {TRUST}")


def _row(one: Listed) -> dict[str, str]:
    return {
        "name": one.identity.common_name,
        "state": _state(one),
        "until": one.until.isoformat(),
        "serial": one.serial,
        "addresses": " ".join(one.addresses),
    }


def _state(one: Listed) -> str:
    if one.is_revoked:
        return "revoked"
    left = one.until - datetime.now(UTC)
    return "expired" if left.total_seconds() <= 0 else "expiring" if left <= WARNING else "ok"
