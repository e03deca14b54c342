"""The result of one of `doctor`'s checks of this machine."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Check:
    """One finding. `message`: what was found; `remedy`: what to do, "" if nothing."""

    name: str
    level: Level
    message: str
    remedy: str = ""
