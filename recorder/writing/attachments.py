"""The files of a site that a recording carries, without anybody's password."""

import mimetypes
import re

from trigpoint.base.errors import ConfigError, TargetError, read_text
from trigpoint.map.building import load_plan, plan_picture
from trigpoint.recorder.session.recording import SITE_ATTACHMENT
from trigpoint.site.config import Site
from trigpoint.site.target import parse_target

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
    for name in dict.fromkeys(site.target_names):
        path = site.path(name)
        text = read_text(path, "target file", TargetError)
        parse_target(text, file=str(path))
        files.append((name, text.encode(), _TOML))
    files += _plan_files(site)
    lenses = [c.intrinsics for c in site.cameras.values() if not c.estimates_intrinsics]
    for name in dict.fromkeys(name for name in lenses if name):
        text = read_text(site.path(name), "camera_info file", ConfigError)
        files.append((name, text.encode(), "application/yaml"))
    return files


def _plan_files(site: Site) -> list[tuple[str, bytes, str]]:
    """The floor plan's two files, as the site file names the one and the one the other."""
    if site.map is None or site.map.plan is None:
        return []
    name = site.map.plan
    load_plan(site)  # what cannot be read is said now, not when the session is opened
    text = read_text(site.path(name), "floor plan", ConfigError)
    picture = plan_picture(name, text)
    kind = mimetypes.guess_type(picture)[0] or "application/octet-stream"
    data = site.path(picture).read_bytes()
    return [(name, text.encode(), "application/yaml"), (picture, data, kind)]
