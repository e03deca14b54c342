"""What other packages write plug-ins with: sources of pictures, and robots' serial protocols.

An entry point of the group `trigpoint.frames` names a `FrameSource`'s class, its name is the scheme
of the URLs that it opens; one of `trigpoint.protocols` names a `Protocol`'s class, its name is what
`protocol` in the site file says.
"""

from trigpoint.base.clock import Clock
from trigpoint.base.errors import FrameError, InputError
from trigpoint.edge.sources.frames import Frame, FrameSource, Stamp, Unreadable, open_source
from trigpoint.robot.line.protocol import (
    Acknowledged,
    Advice,
    ClockExchange,
    Connected,
    Damaged,
    DamageKind,
    Event,
    LocatedPose,
    Mismatched,
    Missing,
    Protocol,
    Reading,
    RobotCorrection,
    Setup,
    Silent,
    StampClock,
    Takes,
    Traits,
    Unanswered,
    Vitals,
    make_protocol,
)
from trigpoint.site.config import CameraConfig, RobotConfig

__all__ = [
    "Acknowledged",
    "Advice",
    "CameraConfig",
    "Clock",
    "ClockExchange",
    "Connected",
    "DamageKind",
    "Damaged",
    "Event",
    "Frame",
    "FrameError",
    "FrameSource",
    "InputError",
    "LocatedPose",
    "Mismatched",
    "Missing",
    "Protocol",
    "Reading",
    "RobotConfig",
    "RobotCorrection",
    "Setup",
    "Silent",
    "Stamp",
    "StampClock",
    "Takes",
    "Traits",
    "Unanswered",
    "Unreadable",
    "Vitals",
    "make_protocol",
    "open_source",
]
