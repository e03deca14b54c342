"""The bus over Zenoh; only this package imports zenoh."""

from trigpoint.zenoh.bus import ZenohBus
from trigpoint.zenoh.datagrams import Datagrams
from trigpoint.zenoh.opening import open_bus, open_router
from trigpoint.zenoh.session import open_session

__all__ = ["Datagrams", "ZenohBus", "open_bus", "open_router", "open_session"]
