"""The result of one of `doctor`'s checks of this machine."""

from typing import Literal, NamedTuple

Level = Literal["ok", "warning", "error"]


class Check(NamedTuple):
    """One finding. `message`: what was found; `remedy`: what to do, "" if nothing."""

    name: str
    level: Level
    message: str
    remedy: str = ""
