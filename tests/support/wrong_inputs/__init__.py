"""Inputs that are wrong in every way that the field reported, drawn, and what is to be said."""

from collections.abc import Mapping

from .bags import BAGS
from .boards import BOARDS
from .case import Case, Kind, fault
from .odometry import ODOMETRY
from .pictures import PICTURES
from .settings import SETTINGS
from .targets import TARGETS

KINDS: Mapping[str, Kind] = {**TARGETS, **PICTURES, **BAGS, **ODOMETRY, **SETTINGS, **BOARDS}
"""By what is wrong."""

__all__ = ["KINDS", "Case", "Kind", "fault"]
