"""The bus over Zenoh; only this package imports zenoh."""

from .bus import ZenohBus
from .datagrams import Datagrams
from .opening import open_bus, open_router
from .session import open_session

__all__ = ["Datagrams", "ZenohBus", "open_bus", "open_router", "open_session"]
