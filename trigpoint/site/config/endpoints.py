"""Endpoints of the bus, such as tcp/192.168.1.10:7447: protocol, host and port."""

import re

ENDPOINT_PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
_ENDPOINT = re.compile(
    rf"(?:{'|'.join(ENDPOINT_PROTOCOLS)})/(?P<host>\[[0-9a-fA-F:.%]+\]|[^\s:/?#\[\]]+)"
    r":(?P<port>[0-9]{1,5})(?:[?#]\S*)?$"
)


def is_endpoint(text: str) -> bool:
    """Whether a text is an endpoint; the other functions here take only valid ones."""
    match = _ENDPOINT.match(text)
    return match is not None and int(match["port"]) <= 65535


def endpoint_host(endpoint: str) -> str:
    """The host of a checked endpoint: tcp/localhost:7447 -> localhost."""
    return _endpoint(endpoint)["host"]


def is_loopback(endpoint: str) -> bool:
    """Whether a checked endpoint stays on this machine."""
    host = endpoint_host(endpoint)
    return host in ("localhost", "[::1]") or host.startswith("127.")


def is_secured(endpoint: str) -> bool:
    """Whether both ends show certificates."""
    return endpoint.startswith(("tls/", "quic/"))


def endpoint_port(endpoint: str) -> int:
    """The port of a checked endpoint; 0 if the system picks one."""
    return int(_endpoint(endpoint)["port"])


def _endpoint(endpoint: str) -> re.Match[str]:
    match = _ENDPOINT.match(endpoint)
    assert match is not None  # guaranteed by BusConfig's check
    return match
