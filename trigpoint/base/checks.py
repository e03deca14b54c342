"""The result of one of `doctor`'s checks of this machine."""

from typing import Literal

from msgspec import Struct

Level = Literal["ok", "warning", "error"]


class Check(Struct, frozen=True):
    """One finding. `message`: what was found; `remedy`: what to do, "" if nothing."""

    name: str
    level: Level
    message: str
    remedy: str = ""
