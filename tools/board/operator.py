"""What an operator may have done from the page: a snapshot, and a map begun anew."""

from collections.abc import Callable

from trigpoint.base.errors import ConfigError, InputError, OperationError
from trigpoint.bus.bus import Bus
from trigpoint.contract.access import Kind
from trigpoint.contract.topics import command_key
from trigpoint.site.config import Site


def check_operator(site: Site) -> None:
    """Raise ConfigError unless the certificate that this machine shows is an operator's."""
    if site.bus.tls is None:
        raise ConfigError(
            "--operator: this site has no certificates, so nobody can tell an operator; secure it "
            "first (docs/how-to/securing.md), or leave --operator out"
        )
    from trigpoint.security.credentials import person_credentials

    identity = person_credentials(site).identity
    if identity.kind is not Kind.OPERATOR:
        raise ConfigError(
            f"--operator: the certificate here is of the {identity.kind} «{identity.name}»; make "
            "an operator's with `trigpoint secure node operator NAME`, or leave --operator out"
        )


class Commands:
    """Any thread; `bus`: gives the open session, None while there is none."""

    def __init__(self, bus: Callable[[], Bus | None], site: Site) -> None:
        self._bus = bus
        snapshots = {f"camera/{name}/snapshot": "image/jpeg" for name in site.cameras}
        self._known = {"fusion/reset": "application/json"} | snapshots
        self._site = site.name

    def give(self, name: str) -> tuple[bytes, str]:
        """Give one command and wait for its answer and its media type; raise InputError where there
        is no such command, OperationError where nobody answers or it is refused."""
        if name not in self._known:
            raise InputError("there is no such command")
        bus = self._bus()
        if bus is None:
            raise OperationError("the site's bus is not reached yet; wait a moment")
        replies = bus.query(command_key(self._site, name))
        if not replies:
            raise OperationError(f"nobody answers to {name}; does that node run?")
        if replies[0].error:
            raise OperationError(replies[0].error)
        return replies[0].payload, self._known[name]
