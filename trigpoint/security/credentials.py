"""A secured site's files on one machine, and the certificate with which a process connects.

`[bus.tls] directory` holds `trust.pem` (an anchor for each admitted node; goes to every machine),
`corrections.pem` (fusion's public key; goes to every robot), and KIND-NAME.key and KIND-NAME.pem of
each node on this machine. Needs the extra `secure`.
"""

import logging
import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import ConfigError
from trigpoint.bus.settings import Door, TlsFiles
from trigpoint.contract.access import Identity, Kind, access_control
from trigpoint.site.config import Site

_log = logging.getLogger(__name__)

TRUST = "trust.pem"
CORRECTIONS = "corrections.pem"
WARNING = timedelta(days=30)
"""How long before a certificate expires a warning is given: time to deliver a new one."""
_PEOPLE = (Kind.OPERATOR, Kind.VIEWER)
_ANCHOR = "anchor "


class Credentials(Struct, frozen=True):
    """A node's own files, checked."""

    identity: Identity
    certificate: Path
    key: Path
    trust: Path

    @property
    def files(self) -> TlsFiles:
        """The files in the form that a session takes."""
        return TlsFiles(
            trust=str(self.trust.absolute()),
            certificate=str(self.certificate.absolute()),
            key=str(self.key.absolute()),
        )

    def complaint(self, now: datetime) -> str:
        """A warning about the certificate's expiry, "" while that is far away. The file is read
        again each time, since it may have been renewed."""
        until = load_certificate(self.certificate).not_valid_after_utc
        if until - now > WARNING:
            return ""
        remedy = f"trigpoint secure renew {self.identity.kind} {self.identity.name}"
        if until <= now:
            return f"the certificate {self.certificate} ran out on {until:%Y-%m-%d}; {remedy}"
        days = (until - now).days
        return f"the certificate {self.certificate} runs out in {days} days; {remedy}"


def directory(site: Site) -> Path:
    """The folder of the site's files on this machine."""
    assert site.bus.tls is not None
    return site.path(site.bus.tls.directory)


def node_credentials(site: Site, kind: Kind, name: str) -> Credentials:
    """The files of one node; raise ConfigError if one is missing, readable by others, or wrong."""
    identity = Identity(site.name, kind, name)
    folder = directory(site)
    key, file = folder / f"{identity.stem}.key", folder / f"{identity.stem}.pem"
    trust = folder / TRUST
    for path in (key, file, trust):
        if not path.exists():
            raise ConfigError(
                f"{path} is not there; make it with `trigpoint secure node {kind} {name}` where "
                "the site's authority is, and copy it here"
            )
    check_private(key)
    check_untouched(trust)
    certificate = load_certificate(file)
    _check_match(file, certificate, key, identity)
    return Credentials(identity, file, key, trust)


def person_credentials(site: Site) -> Credentials:
    """The files of the operator or viewer whose key is on this machine and readable."""
    for kind in _PEOPLE:
        for key in sorted(directory(site).glob(f"{kind}-*.key")):
            if os.access(key, os.R_OK):
                return node_credentials(site, kind, key.stem.removeprefix(f"{kind}-"))
    raise ConfigError(
        f"{directory(site)} has no key of an operator or a viewer that you may read; make one with "
        "`trigpoint secure node viewer NAME` where the site's authority is, and copy it here"
    )


def router_credentials(site: Site) -> Credentials:
    """The files of this machine's only router or gate."""
    found = sorted(directory(site).glob(f"{Kind.ROUTER}-*.key"))
    if len(found) == 1:
        return node_credentials(site, Kind.ROUTER, found[0].stem.removeprefix(f"{Kind.ROUTER}-"))
    what = (
        "no router's key" if not found else f"several routers' keys ({', '.join(map(str, found))})"
    )
    raise ConfigError(
        f"{directory(site)} has {what}; a machine that listens needs its own one: `trigpoint "
        "secure node router NAME --address ADDRESS`"
    )


def door(site: Site, *others: Site) -> Door:
    """How this machine lets others in: its router's certificate, and the rules for everyone in the
    trust file; `others`: sites whose nodes a router admits too."""
    credentials = router_credentials(site)
    trusts = [credentials.trust, *(directory(other) / TRUST for other in others)]
    identities = [identity for path in trusts for identity in trusted(path)]
    names = [site.name, *(other.name for other in others)]
    files = credentials.files
    if others:
        files = replace(files, anchors=b"".join(path.read_bytes() for path in trusts))
    return Door(files, access_control(identities, sites=names))


def fingerprint(site: Site, *others: Site) -> object:
    """A value that changes when a file that `door` reads changes."""
    credentials = router_credentials(site)
    paths = [credentials.trust, credentials.certificate, credentials.key]
    paths += [directory(other) / TRUST for other in others]
    return tuple(path.read_bytes() for path in paths)


def trusted(trust: Path) -> list[Identity]:
    """The identities admitted by the anchors of a trust file."""
    check_untouched(trust)
    found = [anchored(anchor) for anchor in load_certificates(trust)]
    return [identity for identity in found if identity is not None]


def anchored(anchor: x509.Certificate) -> Identity | None:
    """The identity whose certificates an anchor signs; None if it is not an anchor."""
    prefix, _, name = common_name(anchor).partition(_ANCHOR)
    return None if prefix else Identity.parse(name)


def anchor_name(identity: Identity) -> str:
    """The name of the anchor that signs a node's certificates."""
    return _ANCHOR + identity.common_name


def check_private(path: Path) -> None:
    """Raise ConfigError unless only its owner can access the file (0600 or less)."""
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise ConfigError(f"{path} can be read by others (mode {mode:04o}); chmod 600 {path}")


def check_untouched(path: Path) -> None:
    """Raise ConfigError if anyone but its owner can write a file that says who is trusted."""
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o022:
        raise ConfigError(f"{path} can be written by others (mode {mode:04o}); chmod 644 {path}")


def load_certificates(path: Path) -> list[x509.Certificate]:
    """Every certificate of a PEM file; raise ConfigError."""
    try:
        return x509.load_pem_x509_certificates(path.read_bytes())
    except OSError as reason:
        raise ConfigError(f"{path}: cannot be read ({reason.strerror})") from None
    except ValueError:
        raise ConfigError(f"{path} holds no certificate; copy it anew") from None


def load_certificate(path: Path) -> x509.Certificate:
    """The first certificate of a PEM file; raise ConfigError."""
    return load_certificates(path)[0]


def load_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """A private key; raise ConfigError if it is not of our kind."""
    check_private(path)
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except OSError as reason:
        raise ConfigError(f"{path}: cannot be read ({reason.strerror})") from None
    except (ValueError, TypeError):
        raise ConfigError(f"{path} holds no private key; copy it anew") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ConfigError(f"{path} holds no ECDSA key; make it with `trigpoint secure node`")
    return key


def load_public_key(path: Path) -> ec.EllipticCurvePublicKey:
    """A public key; raise ConfigError if it is not of our kind."""
    check_untouched(path)
    try:
        key = serialization.load_pem_public_key(path.read_bytes())
    except OSError as reason:
        raise ConfigError(f"{path}: cannot be read ({reason.strerror})") from None
    except ValueError:
        raise ConfigError(f"{path} holds no public key; copy it anew") from None
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise ConfigError(f"{path} holds no ECDSA key; make it with `trigpoint secure node fusion`")
    return key


def common_name(certificate: x509.Certificate) -> str:
    """The common name in a certificate, "" if it has none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def is_signed_by(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    """Whether one certificate is signed by another's key."""
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def first_complaint(credentials: Iterable[Credentials]) -> str:
    """A warning about certificates that expire soon, "" if none does."""
    now = datetime.now(UTC)
    try:
        return next((text for one in credentials if (text := one.complaint(now))), "")
    except ConfigError as reason:
        return str(reason)


def least_days(credentials: Iterable[Credentials]) -> float | None:
    """Days until the first of these certificates runs out; None without one, or if one cannot be
    read, which `first_complaint` says."""
    now = datetime.now(UTC)
    with suppress(ConfigError):
        ends = [load_certificate(one.certificate).not_valid_after_utc for one in credentials]
        return min(((end - now) / timedelta(days=1) for end in ends), default=None)
    return None


def _check_match(file: Path, certificate: x509.Certificate, key: Path, identity: Identity) -> None:
    if common_name(certificate) != identity.common_name:
        raise ConfigError(
            f"{file} is the certificate of «{common_name(certificate)}», not of "
            f"«{identity.common_name}»; copy the right one"
        )
    if certificate.public_key() != load_key(key).public_key():
        raise ConfigError(f"{key} does not belong to {file}; copy both anew")
