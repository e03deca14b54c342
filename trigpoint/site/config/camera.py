"""`[cameras.NAME]`."""

import math
from typing import Annotated

from msgspec import Meta, Struct
from msgspec.structs import force_setattr

from trigpoint.geometry import CameraModel

from .number_types import Count, NotNegative, Positive

_PICTURE_SCHEMES = ("sim", "dir", "file", "v4l2", "rtsp")
# At more than this from row to row, reading out a picture takes half a second.
_LONGEST_LINE_DELAY_S = 1e-3
OFFSET_SIGMAS = 3.0
"""A picture may be off its stamp by this many sigmas of its camera's time offset."""
# A network camera's pictures are stamped on arrival, or by an unchecked clock; what remains of the
# delay from exposure to arrival (0.05 to 0.5 s) is estimated.
_RTSP_OFFSET_SIGMA_S = 0.2


class CameraConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One camera: where its pictures come from and what is known of its lens."""

    source: str
    width: Count = 640
    height: Count = 480
    rate: Positive = 10.0
    intrinsics: str | None = None
    horizontal_fov: Annotated[float, Meta(gt=0, lt=180)] = 60.0
    focal_sigma: Positive = 0.2
    centre_sigma: Positive = 0.05
    distortion_sigma: Positive = 0.5
    time_offset_sigma: NotNegative = math.nan  # NaN: by the source, see below
    time_drift_sigma: NotNegative = 20e-6
    creep_translation: NotNegative = 2e-4
    creep_rotation: NotNegative = 2e-4
    notice_nudges: bool = False
    line_delay: float = 0.0
    picture_rate: Positive = 2.0
    picture_quality: Annotated[int, Meta(ge=1, le=100)] = 80

    def __post_init__(self) -> None:
        scheme, separator, _ = self.source.partition("://")
        if math.isnan(self.time_offset_sigma):
            usual = _RTSP_OFFSET_SIGMA_S if scheme == "rtsp" else 0.0
            force_setattr(self, "time_offset_sigma", usual)
        if not separator or not scheme:
            known = ", ".join(f"{name}://" for name in _PICTURE_SCHEMES)
            raise ValueError(f"source «{self.source}» is no URL; write one of {known}")
        if self.horizontal_fov <= math.pi:  # no camera looks at a robot through a telescope
            degrees = math.degrees(self.horizontal_fov)
            raise ValueError(
                f"horizontal_fov is {self.horizontal_fov:g}, and in degrees; if that is in "
                f"radians, write {degrees:.1f}"
            )
        if not abs(self.line_delay) <= _LONGEST_LINE_DELAY_S:
            raise ValueError(
                f"line_delay is {self.line_delay:g} s from one row to the next; 30 µs is 30e-6"
            )

    @property
    def scheme(self) -> str:
        """What stands before :// in its source."""
        return self.source.partition("://")[0]

    @property
    def file(self) -> str | None:
        """The path on a machine that its source is, None where it is none."""
        if self.scheme not in ("v4l2", "dir", "file"):
            return None
        place = self.source.partition("://")[2].partition("?")[0]
        return f"/dev/video{place}" if self.scheme == "v4l2" and place.isdigit() else place

    @property
    def place(self) -> str:
        """Its source, which no two cameras have: a device by its path, without options."""
        return (self.file if self.scheme == "v4l2" else None) or self.source

    @property
    def most_time_offset_s(self) -> float:
        """How far its stamps may be off, as its time offset's sigma says; estimated that far."""
        return OFFSET_SIGMAS * self.time_offset_sigma

    @property
    def readout_s(self) -> float:
        """Time between the exposures of the first and the last row, in either direction."""
        return abs(self.line_delay) * (self.height - 1)

    @property
    def estimates_intrinsics(self) -> bool:
        """Whether the intrinsics are estimated from the robot's target."""
        return self.intrinsics == "estimate"

    def nominal(self) -> CameraModel:
        """The lens without distortion at the configured field of view."""
        fov_rad = math.radians(self.horizontal_fov)
        return CameraModel.from_field_of_view(self.width, self.height, fov_rad)
