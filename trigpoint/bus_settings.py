"""From `[bus]` of site.toml to a Zenoh session's settings; knows no Zenoh.

| `[bus]` | session |
| --- | --- |
| omitted | peer on loopback; the site's peers find each other by multicast on loopback |
| `connect`, all on this machine | peer on loopback; told of the others by whom it connects to |
| `connect`, another machine | client: whom it connects to relays everything |
| `listen` with a port | peer on loopback as above; one process of the machine keeps the gate |
| `listen` with port 0 | peer there; the system picks the port |
| `scouting` | peer; found by multicast on the link; listens as written, else on loopback |

Peers pass nothing on between peers, only for clients (measured, 1.10); hence the client.
"""

import socket
import zlib
from dataclasses import dataclass
from typing import Literal

from .config import BusConfig, endpoint_host, endpoint_port
from .errors import BusError

CLIENT_TRY_MS = 1500
LOOPBACK = "tcp/127.0.0.1:0"
MESSAGE_LIMIT_BYTES = 16 << 20
BLOCK_LIMIT_US = 2_000_000
"""How long a put waits for a peer that does not read, before the peer is cut off."""


@dataclass(frozen=True, slots=True)
class Multicast:
    """Where to look for peers: a network interface (or its address) and a group."""

    interface: str
    group: str


@dataclass(frozen=True, slots=True)
class Settings:
    """One session. `gate`: what another session of the machine listens on for all of them."""

    mode: Literal["peer", "client"]
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    multicast: Multicast | None = None
    gate: tuple[str, ...] = ()

    def values(self) -> dict[str, object]:
        """Zenoh's configuration keys and their values."""
        values: dict[str, object] = {
            "mode": self.mode,
            "listen/endpoints": list(self.listen),
            "connect/endpoints": list(self.connect),
            "connect/retry": {"period_init_ms": 500, "period_max_ms": 2000},
            # A client's first try ends after this; one refused by a dead route took 10 s without.
            # A peer opens at once and keeps trying on its own.
            "connect/timeout_ms": {"client": CLIENT_TRY_MS, "peer": -1, "router": -1},
            "scouting/multicast/enabled": self.multicast is not None,
            "scouting/gossip/enabled": self.mode == "peer",
            # Off for peers and clients by default; caches and the recording need them.
            "timestamping/enabled": True,
            # A killed process would leave its segments behind; loopback TCP is fast enough.
            "transport/shared_memory/enabled": False,
            "transport/link/rx/max_message_size": MESSAGE_LIMIT_BYTES,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCK_LIMIT_US,
        }
        if self.multicast is not None:
            values["scouting/multicast/interface"] = self.multicast.interface
            values["scouting/multicast/address"] = self.multicast.group
        return values

    @property
    def locators(self) -> tuple[str, ...]:
        """Where others can connect to, as far as it is known."""
        return tuple(e for e in self.gate or self.listen if endpoint_port(e) != 0)

    @property
    def meets_others(self) -> bool:
        """Whether the session learns of its peers one after the other."""
        return self.mode == "peer" and (bool(self.connect) or self.multicast is not None)

    def gate_settings(self) -> "Settings":
        """The session that listens on `gate` and relays between there and this machine's peers."""
        return Settings("peer", (LOOPBACK, *self.gate), multicast=self.multicast)


def session_settings(site: str, bus: BusConfig) -> Settings:
    """The table above."""
    if bus.scouting:
        listen = bus.listen or (LOOPBACK,)
        return Settings("peer", listen, bus.connect, Multicast("auto", "224.0.0.224:7446"))
    if any(endpoint_port(endpoint) == 0 for endpoint in bus.listen):
        return Settings("peer", tuple(_with_port(e) for e in bus.listen), bus.connect)
    if bus.listen:
        group = _loopback_group(site, *bus.listen)
        return Settings("peer", (LOOPBACK,), bus.connect, group, gate=bus.listen)
    if all(_is_loopback(endpoint) for endpoint in bus.connect):
        group = None if bus.connect else _loopback_group(site)
        return Settings("peer", (LOOPBACK,), bus.connect, group)
    return Settings("client", connect=bus.connect)


def _with_port(endpoint: str) -> str:
    """The endpoint with a free port in place of 0: Zenoh does not tell which one it took."""
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


def _is_loopback(endpoint: str) -> bool:
    host = endpoint_host(endpoint)
    return host in ("localhost", "[::1]") or host.startswith("127.")


def _loopback_group(*names: str) -> Multicast:
    """A group of the local scope (RFC 2365) by the names, so that only these peers meet."""
    number = zlib.crc32("\n".join(names).encode())
    return Multicast("127.0.0.1", f"239.255.{number >> 8 & 255}.{number & 255}:7446")
