"""The bus over Zenoh; the one place that knows zenoh."""

from .bus import ZenohBus
from .datagrams import Datagrams
from .opening import open_bus, open_router
from .session import open_session

__all__ = ["Datagrams", "ZenohBus", "open_bus", "open_router", "open_session"]
