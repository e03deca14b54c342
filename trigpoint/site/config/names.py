"""Names of sites, cameras, robots and frames: parts of keys and of ROS topics."""

import re

from trigpoint.base.errors import ConfigError

_NAME = re.compile(r"[a-z][a-z0-9_]*")


def check_name(what: str, name: str) -> None:
    """Raise ConfigError if a name cannot be part of a key and of a ROS topic."""
    try:
        validate_name(what, name)
    except ValueError as reason:
        raise ConfigError(str(reason)) from None


def validate_name(what: str, name: str) -> None:
    """Like `check_name`, but raise ValueError, as checks inside a struct must."""
    if not _NAME.fullmatch(name) or "__" in name:
        raise ValueError(
            f"the {what}'s name «{name}» must match [a-z][a-z0-9_]* without «__»; rename it"
        )
