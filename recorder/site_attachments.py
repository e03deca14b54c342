"""The files of a site that a recording carries, without anybody's password."""

import re

from trigpoint.config import Site
from trigpoint.errors import ConfigError, TargetError, read_text
from trigpoint.target import parse_target

from .recording import SITE_ATTACHMENT

_TOML = "application/toml"
MASK = "***"
# user:password@ of a URL, where a password may hold anything but a blank or a quote.
_USER = re.compile(r"""(://[^\s"':@/]*):[^\s"']*@""")
_QUERY = re.compile(r"""([?&](?:pass|password|passwd|pwd|token|secret|key)=)[^&\s"']*""", re.I)


def without_passwords(text: str) -> str:
    """A site file's text with the passwords in its URLs masked; it stays a site file."""
    return _QUERY.sub(rf"\g<1>{MASK}", _USER.sub(rf"\g<1>:{MASK}@", text))


def site_files(site: Site) -> list[tuple[str, bytes, str]]:
    """(name as the site file writes it, bytes, media type) of everything that a session needs.

    Raises ConfigError or TargetError where a file is missing or wrong.
    """
    files = [(SITE_ATTACHMENT, without_passwords(site.text).encode(), _TOML)]
    for name in dict.fromkeys(site.target_name(robot) for robot in site.robots):
        path = site.path(name)
        text = read_text(path, "target file", TargetError)
        parse_target(text, file=str(path))
        files.append((name, text.encode(), _TOML))
    lenses = [c.intrinsics for c in site.cameras.values() if not c.estimates_intrinsics]
    for name in dict.fromkeys(name for name in lenses if name):
        text = read_text(site.path(name), "camera_info file", ConfigError)
        files.append((name, text.encode(), "application/yaml"))
    return files
