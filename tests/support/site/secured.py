"""A secured site for tests: its file, its authority, and sessions that show a certificate."""

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from support.builders import site_text

from trigpoint.bus.settings import Settings, router_settings
from trigpoint.contract.access import Identity, Kind
from trigpoint.security.credentials import door, node_credentials
from trigpoint.site.config import Site, parse_site
from trigpoint.tools.secure.authority import Authority, addresses_of
from trigpoint.zenoh import open_session
from trigpoint.zenoh.patience import open_patiently

NODES = (
    (Kind.ROUTER, "hall"),
    (Kind.CAMERA, "c1"),
    (Kind.ROBOT, "r1"),
    (Kind.FUSION, "fusion"),
    (Kind.RECORDER, "main"),
    (Kind.OPERATOR, "anna"),
    (Kind.VIEWER, "bob"),
)

_ZENOHD = shutil.which("zenohd")
needs_zenohd = pytest.mark.skipif(_ZENOHD is None, reason="zenohd is not installed here")
_PATIENCE_S = 60.0


class SecuredSite:
    """A site in a folder, with an authority that has admitted `NODES`."""

    def __init__(
        self, folder: Path, port: int, *, name: str = "lab", bus: str = "", protocol: str = "tls"
    ) -> None:
        self.folder, self.name, self.endpoint = folder, name, f"{protocol}/127.0.0.1:{port}"
        self.authority = Authority(name, folder / "authority", folder / "secure")
        self.authority.create()
        for kind, node in NODES:
            self.admit(kind, node)
        self.listening = self.site(bus or f'listen = ["{self.endpoint}"]')
        self.connecting = self.site(f'connect = ["{self.endpoint}"]')

    def admit(self, kind: Kind, node: str, *, days: int = 90) -> None:
        identity = Identity(self.name, kind, node)
        self.authority.issue(identity, days, addresses_of(kind, ()))

    def site(self, bus: str, *, more: str = "") -> Site:
        text = site_text(
            name=self.name,
            bus=f"{bus}\n[bus.tls]",
            cameras=2,
            robots=2,
            more=more,
        )
        return parse_site(text, directory=self.folder)

    @contextmanager
    def zenohd(self) -> Iterator[None]:
        """The stock router with the configuration that `secure router` writes."""
        assert _ZENOHD is not None  # see `needs_zenohd`
        settings = router_settings(self.name, self.listening.bus, door(self.listening))
        written = self.folder / "router.json5"
        written.write_text(json.dumps(settings.document()))
        with (self.folder / "zenohd.log").open("wb") as log:
            process = subprocess.Popen([_ZENOHD, "-c", written], stdout=log, stderr=log)
        try:
            yield
        finally:
            process.terminate()
            process.wait(10)

    def settings(self, kind: Kind, node: str) -> Settings:
        """A client's with the node's certificate, whatever the endpoint's host."""
        files = node_credentials(self.connecting, kind, node).files
        return Settings("client", connect=(self.endpoint,), files=files)

    def session(self, kind: Kind, node: str) -> zenoh.Session:
        """As the programs open it: they try again where a busy machine takes too long."""
        settings = self.settings(kind, node)
        return open_patiently(lambda: open_session(settings), settings, _PATIENCE_S)


Open = Callable[[Kind, str], zenoh.Session]
