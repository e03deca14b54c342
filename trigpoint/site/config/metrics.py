"""`[metrics]`."""

from msgspec import Struct

from .endpoints import is_endpoint, is_loopback


class MetricsConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Where each program of the site on a machine serves Prometheus's /metrics."""

    listen: str | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if self.listen is None:
            return
        if not is_endpoint(f"tcp/{self.listen}"):
            raise ValueError(f"«{self.listen}» is no host and port; write one like 127.0.0.1:9464")
        if not self.insecure and not is_loopback(f"tcp/{self.listen}"):
            raise ValueError(
                f"whoever reaches «{self.listen}» can read the site's state; listen on 127.0.0.1 "
                "behind a proxy with TLS, or write insecure = true under [metrics]"
            )
