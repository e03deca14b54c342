"""Where a program serves its nodes' metrics, if anywhere. The library is loaded only then."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from trigpoint.base.errors import ConfigError
from trigpoint.contract.messages import Diagnostics
from trigpoint.site.config import MetricsConfig, Site

_log = logging.getLogger(__name__)

OFF = "off"


class Reporter(Protocol):
    """A node, as far as this matters."""

    @property
    def reported(self) -> Diagnostics | None: ...


@contextmanager
def metrics_served(site: Site, at: str, nodes: Sequence[Reporter]) -> Iterator[str]:
    """Serve these nodes' metrics inside the `with` block; gives the address, "" if there is none.

    `at`: HOST:PORT or «off» from the command line, which goes before the site file; "" if it was
    not given. Raises ConfigError if that is no address, OperationError if it cannot be had.
    """
    listen = _listen(site, at)
    if listen is None:
        yield ""
        return
    from .families import families
    from .server import served

    def collect() -> list:
        return families(site.name, [one for node in nodes if (one := node.reported) is not None])

    with served(listen, collect) as address:
        _log.info("metrics are at %s", address)
        yield address


def _listen(site: Site, at: str) -> str | None:
    if at in ("", OFF):
        return None if at else site.metrics.listen
    try:
        return MetricsConfig(at, insecure=site.metrics.insecure).listen
    except ValueError as reason:
        raise ConfigError(f"--metrics: {reason}") from None
