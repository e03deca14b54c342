"""site.toml as frozen structs, one per table; errors name file, line and key."""

from .bus import BusConfig, RouterConfig, TlsConfig
from .camera import OFFSET_SIGMAS, CameraConfig
from .endpoints import (
    endpoint_host,
    endpoint_port,
    is_loopback,
    is_secured,
)
from .fusion import FusionConfig, PriorConfig
from .map import MapConfig, PointConfig
from .metrics import MetricsConfig
from .names import check_name
from .number_types import Count, NotNegative, Positive, Probability
from .recorder import RecorderConfig
from .robot import (
    ROS2_PROTOCOL,
    MavlinkConfig,
    OdometryNoise,
    RobotConfig,
    SafetyConfig,
    WheelConfig,
)
from .site import Site, load_site, parse_site

__all__ = [
    "OFFSET_SIGMAS",
    "ROS2_PROTOCOL",
    "BusConfig",
    "CameraConfig",
    "Count",
    "FusionConfig",
    "MapConfig",
    "MavlinkConfig",
    "MetricsConfig",
    "NotNegative",
    "OdometryNoise",
    "PointConfig",
    "Positive",
    "PriorConfig",
    "Probability",
    "RecorderConfig",
    "RobotConfig",
    "RouterConfig",
    "SafetyConfig",
    "Site",
    "TlsConfig",
    "WheelConfig",
    "check_name",
    "endpoint_host",
    "endpoint_port",
    "is_loopback",
    "is_secured",
    "load_site",
    "parse_site",
]
