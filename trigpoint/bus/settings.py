"""Translates `[bus]` of site.toml into a Zenoh session's settings; does not import zenoh.

| `[bus]` | session |
| --- | --- |
| omitted | peer on loopback; the site's peers find each other by multicast on loopback |
| `connect`, all on this machine | peer on loopback; learns of the others from its endpoint |
| `connect`, another machine | client: the endpoint relays everything |
| `listen` with a port | peer on loopback as above; one process of the machine keeps the gate |
| `listen` with port 0 | peer there; the system picks the port |
| `scouting` | peer; found by multicast on the link; listens as written, else on loopback |

Peers relay nothing between peers, only for clients (measured, 1.10); hence the client. With
`[bus.tls]`, connecting nodes show their own certificates, and the gate the machine's (`security`).
"""

import base64
import socket
import zlib
from typing import Literal

from msgspec import Struct

from trigpoint.base.errors import BusError, ConfigError
from trigpoint.contract import topics
from trigpoint.site.config import BusConfig, endpoint_host, endpoint_port, is_loopback

TRY_MS, ACCEPT_TIMEOUT_MS = 5000, 3000
"""How long a handshake may take, for who connects and who accepts. With 3000 for both, nodes on a
very busy machine and a network that loses packets did not find their way back to a router."""
LOOPBACK = "tcp/127.0.0.1:0"
MESSAGE_LIMIT_BYTES = 16 << 20
BLOCK_LIMIT_US = 1_000_000
"""How long a put waits for a peer that does not read, before the peer is cut off."""

QUEUE_BATCHES = 16
"""Batches of 64 kB that may wait for a link, by priority; Zenoh's maximum. After a break, a
publisher's whole cache (1024 odometry messages, 717 kB) is requested at once. With the usual two
batches, a slow link (5 % loss, 100 ms) held that up so long that it was cut off, reconnected, was
asked again, and never recovered."""


class Multicast(Struct, frozen=True):
    """Where to look for peers: a network interface (or its address) and a group."""

    interface: str
    group: str


class TlsFiles(Struct, frozen=True):
    """What a secured site's session shows, and whom it trusts: paths of PEM files.

    `anchors`: PEM text of all trusted anchors, if there are more than `trust` holds.
    """

    trust: str
    certificate: str
    key: str
    anchors: bytes = b""

    def values(self) -> dict[str, object]:
        """Zenoh's settings below `transport/link/tls`."""
        whom: dict[str, object] = {"root_ca_certificate": self.trust}
        if self.anchors:
            whom = {"root_ca_certificate_base64": base64.b64encode(self.anchors).decode()}
        return whom | {
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
            "listen_certificate": self.certificate,
            "listen_private_key": self.key,
            "connect_certificate": self.certificate,
            "connect_private_key": self.key,
        }


class Door(Struct, frozen=True):
    """How a session admits others: its certificate, and Zenoh's `access_control`."""

    files: TlsFiles
    access: dict[str, object]


class Settings(Struct, frozen=True):
    """One session.

    `gate`: the endpoint on which another session listens for the whole machine; `files`: what it
    shows when it connects; `access`: what connecting nodes may do, None: everything;
    `picture_rate`: how many pictures per second and camera it relays, None: all.
    """

    mode: Literal["peer", "client", "router"]
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    multicast: Multicast | None = None
    gate: tuple[str, ...] = ()
    files: TlsFiles | None = None
    access: dict[str, object] | None = None
    picture_rate: float | None = None

    def values(self) -> dict[str, object]:
        """Zenoh's configuration keys and their values."""
        values: dict[str, object] = {
            "mode": self.mode,
            "listen/endpoints": [_as_zenoh(endpoint) for endpoint in self.listen],
            "connect/endpoints": [_as_zenoh(endpoint) for endpoint in self.connect],
            "connect/retry": {"period_init_ms": 500, "period_max_ms": 1000},
            # A client tries once, and after a lost link again and again. With a limit for all that,
            # of 1.5 s, a handshake that lost packets was given up and begun anew, five times in a
            # row (100 ms, 5 % lost), and each link given up held up the router (`session`).
            # A peer opens at once and keeps trying on its own.
            "connect/timeout_ms": {"client": 0, "peer": -1, "router": -1},
            # A try on a dead route ends after this.
            "transport/unicast/open_timeout": TRY_MS,
            "scouting/multicast/enabled": self.multicast is not None,
            "scouting/gossip/enabled": self.mode != "client",
            # Off by default for peers and clients; caches and recordings need them.
            "timestamping/enabled": True,
            # A killed process would leave its segments behind; loopback TCP is fast enough.
            "transport/shared_memory/enabled": False,
            # Do not wait for silent connections; a stop would wait too.
            "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
            "transport/link/rx/max_message_size": MESSAGE_LIMIT_BYTES,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCK_LIMIT_US,
            "transport/link/tx/queue/size/data_high": QUEUE_BATCHES,
            "transport/link/tx/queue/size/data": QUEUE_BATCHES,
        }
        if self.multicast is not None:
            values["scouting/multicast/interface"] = self.multicast.interface
            values["scouting/multicast/address"] = self.multicast.group
        if self.files is not None:
            values["transport/link/tls"] = self.files.values()
        if self.access is not None:
            values["access_control"] = self.access
        if self.picture_rate is not None:
            values["downsampling"] = [_fewer_pictures(self.picture_rate)]
        return values

    def document(self) -> dict[str, object]:
        """The same as one nested document, in the form that `zenohd` reads."""
        root: dict[str, object] = {}
        for path, value in self.values().items():
            *tables, last = path.split("/")
            table = root
            for name in tables:
                inner = table.setdefault(name, {})
                assert isinstance(inner, dict)  # a path is a value or a table, never both
                table = inner
            table[last] = value
        return root

    @property
    def locators(self) -> tuple[str, ...]:
        """Endpoints that others can connect to, as far as they are known."""
        return tuple(e for e in self.gate or self.listen if endpoint_port(e) != 0)

    @property
    def meets_others(self) -> bool:
        """Whether the session discovers its peers gradually."""
        return self.mode == "peer" and (bool(self.connect) or self.multicast is not None)

    def gate_settings(self, door: Door | None = None) -> "Settings":
        """The session that listens on `gate` and relays between it and this machine's peers."""
        files, access = (door.files, door.access) if door else (None, None)
        listen = (LOOPBACK, *self.gate)
        return Settings("peer", listen, multicast=self.multicast, files=files, access=access)


def router_settings(
    site: str, bus: BusConfig, door: Door | None, *, picture_rate: float | None = None
) -> Settings:
    """A router in place of the gate: it also relays between the nodes that connect, and to the
    routers named in `connect`."""
    if not bus.listen:
        raise ConfigError(
            f"site {site}: a router needs to be told where the others connect to it: write "
            'listen = ["tcp/<address of this machine>:7447"] below [bus] in the site file'
        )
    return Settings(
        "router",
        (LOOPBACK, *bus.listen),
        bus.connect,
        _loopback_group(site, *bus.listen),
        files=door.files if door else None,
        access=door.access if door else None,
        picture_rate=picture_rate,
    )


def session_settings(site: str, bus: BusConfig, files: TlsFiles | None = None) -> Settings:
    """As in the table above; `files`: what is shown on links that leave this machine."""
    if bus.scouting:
        listen = bus.listen or (LOOPBACK,)
        return Settings("peer", listen, bus.connect, Multicast("auto", "224.0.0.224:7446"))
    if any(endpoint_port(endpoint) == 0 for endpoint in bus.listen):
        return Settings("peer", tuple(_with_port(e) for e in bus.listen), bus.connect)
    if bus.listen:
        group = _loopback_group(site, *bus.listen)
        return Settings("peer", (LOOPBACK,), bus.connect, group, gate=bus.listen, files=files)
    if all(is_loopback(endpoint) for endpoint in bus.connect):
        group = None if bus.connect else _loopback_group(site)
        return Settings("peer", (LOOPBACK,), bus.connect, group, files=files)
    return Settings("client", connect=_streams(bus.connect), files=files)


def has_datagrams(bus: BusConfig) -> bool:
    """Whether some link of the site carries datagrams."""
    return any(map(_is_quic, (*bus.connect, *bus.listen)))


def datagram_settings(bus: BusConfig, settings: Settings) -> Settings | None:
    """A second client beside the one that `settings` describes, for datagrams; None if that one
    carries datagrams itself, or is not a client."""
    beside = tuple(e for e in bus.connect if e not in settings.connect)
    return Settings("client", connect=beside, files=settings.files) if beside else None


def _streams(connect: tuple[str, ...]) -> tuple[str, ...]:
    """Where a client connects to for reliable samples; QUIC only if there is nothing else. With 5 %
    loss and 100 ms, a QUIC stream was slower than TCP (p50 of odometry 290 against 156 ms): its
    window grows only while it is full."""
    return tuple(e for e in connect if not _is_quic(e)) or connect


def _is_quic(endpoint: str) -> bool:
    return endpoint.startswith("quic/")


def _fewer_pictures(rate: float) -> dict[str, object]:
    """Zenoh's downsampling of outgoing pictures, of every site."""
    rules = [{"key_expr": f"*/{topics.IMAGE.path.format(id='*')}", "freq": rate}]
    return {"id": "pictures", "messages": ["put"], "flows": ["egress"], "rules": rules}


def _as_zenoh(endpoint: str) -> str:
    """The endpoint with Zenoh's options. Over QUIC each priority has its own stream, so that a loss
    on one holds up no other, and best-effort samples go as datagrams."""
    return f"{endpoint}?multistream=1;mixed_rel=1" if _is_quic(endpoint) else endpoint


def _with_port(endpoint: str) -> str:
    """The endpoint with a free port in place of 0: Zenoh does not say which one it took."""
    if endpoint_port(endpoint) != 0:
        return endpoint
    host = endpoint_host(endpoint)
    try:
        with socket.create_server((host.strip("[]"), 0), family=_family(host)) as server:
            port = server.getsockname()[1]
    except OSError as reason:
        raise BusError(
            f"nothing can listen on {endpoint} ({reason.strerror}); correct bus.listen"
        ) from None
    return endpoint.replace(f"{host}:0", f"{host}:{port}", 1)


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if host.startswith("[") else socket.AF_INET


def _loopback_group(*names: str) -> Multicast:
    """A local-scope group (RFC 2365) derived from the names, so that only these peers meet."""
    number = zlib.crc32("\n".join(names).encode())
    return Multicast("127.0.0.1", f"239.255.{number >> 8 & 255}.{number & 255}:7446")
