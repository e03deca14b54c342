"""What `doctor` asks each part for: one finding about this machine."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Check:
    """One finding. `message` says what is; `remedy` what to do, "" where nothing is to be done."""

    name: str
    level: Level
    message: str
    remedy: str = ""
