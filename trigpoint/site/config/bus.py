"""`[bus]` and `[router]`: how the programs of a site connect."""

from msgspec import Struct

from .endpoints import ENDPOINT_PROTOCOLS, endpoint_port, is_endpoint, is_loopback, is_secured
from .number_types import Positive


class TlsConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Mutual TLS on every link that leaves the machine; `trigpoint secure` makes the files."""

    directory: str = "secure"


class BusConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How the nodes find each other; by default on this machine only."""

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    scouting: bool = False
    insecure: bool = False
    tls: TlsConfig | None = None

    def __post_init__(self) -> None:
        for endpoint in (*self.connect, *self.listen):
            if not is_endpoint(endpoint):
                raise ValueError(
                    f"«{endpoint}» is no endpoint; write one like tcp/192.168.1.10:7447 "
                    f"(with {', '.join(ENDPOINT_PROTOCOLS)})"
                )
        for endpoint in self.connect:
            if endpoint_port(endpoint) == 0:
                raise ValueError(f"«{endpoint}» has no port to connect to; write the other's port")
        if self.tls is None:
            self._check_plain()
        else:
            self._check_secured()

    def _check_plain(self) -> None:
        for endpoint in (*self.connect, *self.listen):
            if is_secured(endpoint):
                raise ValueError(f"«{endpoint}» needs certificates; write [bus.tls]")
        if self.open_doors and not self.insecure:
            raise ValueError(
                f"whoever reaches {' and '.join(self.open_doors)} can move the robots; secure the "
                "site (trigpoint secure init, [bus.tls]), or write insecure = true"
            )

    def _check_secured(self) -> None:
        if self.insecure or self.scouting:
            key = "insecure" if self.insecure else "scouting"
            raise ValueError(f"{key} = true undoes [bus.tls]; take one of the two out")
        for endpoint in (*self.connect, *self.listen):
            if not is_loopback(endpoint) and not is_secured(endpoint):
                raise ValueError(
                    f"«{endpoint}» leaves this machine in the clear; write tls/… or quic/…"
                )
            if "#" in endpoint or "?" in endpoint:
                raise ValueError(f"«{endpoint}» sets rules of its own; end it with the port")
        for endpoint in self.listen:
            if endpoint_port(endpoint) == 0:
                raise ValueError(f"«{endpoint}» has no port that others can be told; write one")

    @property
    def open_doors(self) -> tuple[str, ...]:
        """The settings that give anyone on the network a session without a certificate."""
        if self.tls is not None:
            return ()
        doors = tuple(f"«{endpoint}»" for endpoint in self.listen if not is_loopback(endpoint))
        return (*doors, "scouting") if self.scouting else doors


class RouterConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The site's router, if it has one."""

    picture_rate: Positive | None = None
