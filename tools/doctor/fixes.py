"""`doctor --fix`: groups, udev rules, time synchronisation."""

import grp
import os
import pwd
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from trigpoint.base.checks import Check
from trigpoint.base.errors import InputError, writing
from trigpoint.site.config import Site

UDEV_RULES = Path("/etc/udev/rules.d/70-trigpoint.rules")
RULES = Path(__file__).with_name(UDEV_RULES.name).read_text(encoding="utf-8")
_RUN_S = 120.0


class Fix(Struct, frozen=True):
    """One repair: a file to write, and the commands to run afterwards."""

    name: str
    does: str
    commands: tuple[tuple[str, ...], ...]
    file: Path | None = None
    text: str = ""


def needed(site: Site, *, user: str, rules: Path = UDEV_RULES, clock: Check) -> list[Fix]:
    """The repairs needed for the site's cameras and ports, for the user who runs them."""
    return [*_groups(site, user), *_rules(site, rules), *_clock(clock)]


def fixed_user() -> str:
    """The user whose groups are changed: the caller of sudo; raise InputError unless root."""
    if os.geteuid() != 0:
        raise InputError("doctor --fix changes the system; run it with sudo")
    return os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name


def apply(fix: Fix) -> Check:
    """Apply a repair; the finding says whether it succeeded."""
    if fix.file is not None:
        with writing(fix.file):
            fix.file.parent.mkdir(parents=True, exist_ok=True)
            fix.file.write_text(fix.text, encoding="utf-8")
    for words in fix.commands:
        if reason := _failure(words):
            return Check(fix.name, "error", f"{' '.join(words)}: {reason}", "mend that by hand")
    return Check(fix.name, "ok", f"mended: {fix.does}")


def _failure(words: tuple[str, ...]) -> str:
    """Why a command failed, "" if it succeeded."""
    if shutil.which(words[0]) is None:
        return "is not installed"
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=_RUN_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as reason:
        return str(reason)
    return "" if done.returncode == 0 else " ".join(done.stderr.split()) or "failed"


def _groups(site: Site, user: str) -> Iterator[Fix]:
    if user == "root":
        return
    wanted = {"video": _has_cameras(site), "dialout": _has_ports(site)}
    for group, is_wanted in wanted.items():
        if is_wanted and not _is_member(user, group):
            does = f"{user} is in the group {group} from the next login on"
            yield Fix(f"group {group}", does, (("usermod", "-aG", group, user),))


def _rules(site: Site, path: Path) -> Iterator[Fix]:
    if not (_has_cameras(site) or _has_ports(site)):
        return
    if not path.exists() or path.read_text(encoding="utf-8") != RULES:
        reload = (("udevadm", "control", "--reload"), ("udevadm", "trigger"))
        yield Fix("udev rules", f"{path} is written", reload, path, RULES)


def _clock(clock: Check) -> Iterator[Fix]:
    if clock.level == "ok":
        return
    for unit, program in (("chrony", "chronyd"), ("systemd-timesyncd", "timedatectl")):
        if shutil.which(program):
            words = ("systemctl", "enable", "--now", unit)
            yield Fix("clock", f"{unit} keeps it", (words,))
            return


def _has_cameras(site: Site) -> bool:
    return any(camera.source.startswith("v4l2://") for camera in site.cameras.values())


def _has_ports(site: Site) -> bool:
    return any((robot.port or "").startswith("/dev/") for robot in site.robots.values())


def _is_member(user: str, group: str) -> bool:
    try:
        found, who = grp.getgrnam(group), pwd.getpwnam(user)
    except KeyError:
        return False
    return user in found.gr_mem or who.pw_gid == found.gr_gid
