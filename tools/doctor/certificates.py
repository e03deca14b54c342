"""`doctor`'s checks of a secured site's files on this machine."""

from datetime import UTC, datetime

from trigpoint.base.checks import Check
from trigpoint.base.errors import ConfigError
from trigpoint.contract.access import Identity, Kind
from trigpoint.security.credentials import TRUST, directory, node_credentials, trusted
from trigpoint.site.config import Site


def check_certificates(site: Site) -> list[Check]:
    """One finding per key: is it well protected, is its certificate valid, is it trusted?"""
    folder = directory(site)
    keys = sorted(folder.glob("*-*.key"))
    if not keys:
        remedy = "`trigpoint secure node KIND ID` where the site's authority is"
        return [Check("certificates", "error", f"{folder} has no key", remedy)]
    try:
        admitted = set(trusted(folder / TRUST))
    except ConfigError as reason:
        return [Check("certificates", "error", str(reason), f"copy {TRUST} here")]
    return [_check(site, key.stem, admitted) for key in keys]


def _check(site: Site, stem: str, admitted: set[Identity]) -> Check:
    kind, _, name = stem.partition("-")
    title = f"certificate of {kind} {name}"
    if kind not in set(Kind):
        return Check(title, "error", f"there are no nodes of the kind «{kind}»", "take it away")
    try:
        credentials = node_credentials(site, Kind(kind), name)
        complaint = credentials.complaint(datetime.now(UTC))
    except ConfigError as reason:
        return Check(title, "error", str(reason))
    if credentials.identity not in admitted:
        return Check(
            title,
            "error",
            f"{credentials.trust} does not know it: it was revoked, or the file is old",
            f"copy {TRUST} from where the site's authority is",
        )
    if complaint:
        is_over = "ran out" in complaint
        return Check(title, "error" if is_over else "warning", complaint)
    return Check(title, "ok", "holds for more than 30 days")
