"""Log lines on standard error: time, level, where, what."""

import logging
import sys
from enum import StrEnum

_FORMAT = "%(asctime)s.%(msecs)03d %(levelname)s %(name)s: %(message)s"


class Level(StrEnum):
    """Names of the log's levels."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def set_up(level: Level) -> None:
    """Send the program's log to standard error; other libraries only from warnings on."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(_FORMAT, datefmt="%H:%M:%S"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING, force=True)
    logging.getLogger("trigpoint").setLevel(level.upper())
    for name in Level:
        logging.addLevelName(logging.getLevelNamesMapping()[name.upper()], name.value)
