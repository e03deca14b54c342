"""A site's authority: its key, the anchors of the nodes that may come in, and their certificates.

Zenoh reads no revocation list. So each node has an anchor of its own: a small certificate authority
that the site's authority signs and that signs this node's certificates alone. `trust.pem` is the
anchors of all who may come in; to revoke is to take one out (decisions/0711).
"""

import ipaddress
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec import Struct

from trigpoint.base.disk import replace_file
from trigpoint.base.errors import InputError, writing
from trigpoint.contract.access import Identity, Kind
from trigpoint.security.credentials import (
    CORRECTIONS,
    TRUST,
    anchor_name,
    anchored,
    common_name,
    is_signed_by,
    load_certificate,
    load_certificates,
    load_key,
)
from trigpoint.site.config import Site, TlsConfig

_LONG = timedelta(days=20 * 365)
"""Validity of the authority and the anchors; they end by revocation instead."""
_SKEW = timedelta(hours=1)
"""A machine whose clock is this much behind still accepts a fresh certificate."""
_LONGEST_NAME = 64
"""Length of a common name (RFC 5280, ub-common-name), including an anchor's prefix."""
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")


class Listed(Struct, frozen=True):
    """One node as `secure list` shows it. `state`: ok, expiring, expired or revoked."""

    identity: Identity
    serial: str
    until: datetime
    addresses: tuple[str, ...]
    is_revoked: bool


class Authority:
    """The authority's private `folder`, and the folder of the files that are `given` out."""

    def __init__(self, site: str, folder: Path, given: Path) -> None:
        self._site, self.folder, self.given = site, folder, given
        self._anchors, self._revoked = folder / "anchors", folder / "revoked"

    @classmethod
    def of(cls, site: Site, folder: Path | None) -> "Authority":
        """A site's; `folder`: of its own, if that is not beside the site file."""
        given = site.path((site.bus.tls or TlsConfig()).directory)
        return cls(site.name, folder or site.path("authority"), given)

    @property
    def trust(self) -> Path:
        """The file that lists who is admitted."""
        return self.given / TRUST

    def create(self) -> None:
        """Make the authority's key and certificate; raise InputError if they exist."""
        if (self.folder / "authority.key").exists():
            raise InputError(f"{self.folder} has an authority already; move it away first")
        key = ec.generate_private_key(ec.SECP256R1())
        name = f"authority of {self._site}"
        certificate = _signed(name, key, name, key, _LONG, is_authority=True)
        for folder in (self.folder, self._anchors, self._revoked):
            _make_folder(folder, 0o700)
        _make_folder(self.given, 0o755)
        _write_key(self.folder / "authority.key", key)
        _write(self.folder / "authority.pem", _pem(certificate), 0o644)
        self._write_trust()

    def issue(self, identity: Identity, days: int, addresses: Sequence[str]) -> list[Path]:
        """Make a node's key and certificate and admit it; return the node's files."""
        if len(anchor_name(identity)) > _LONGEST_NAME:
            raise InputError(
                f"«{identity.common_name}» is too long a name for a certificate; at most "
                f"{_LONGEST_NAME - len(anchor_name(identity)) + len(identity.common_name)} letters"
            )
        anchor = self._anchor_files(identity)
        if anchor[0].exists():
            raise InputError(
                f"{identity.kind} {identity.name} has a certificate already; "
                "`trigpoint secure renew` prolongs it, `secure revoke` ends it"
            )
        authority = load_key(self.folder / "authority.key")
        anchor_key = ec.generate_private_key(ec.SECP256R1())
        name, issuer = anchor_name(identity), f"authority of {self._site}"
        certificate = _signed(name, anchor_key, issuer, authority, _LONG, is_authority=True)
        _write_key(anchor[0], anchor_key)
        _write(anchor[1], _pem(certificate), 0o644)
        key = ec.generate_private_key(ec.SECP256R1())
        _write_key(self.given / f"{identity.stem}.key", key)
        self._certify(identity, key.public_key(), days, addresses)
        self._write_trust()
        files = [self.given / f"{identity.stem}.key", self.given / f"{identity.stem}.pem"]
        if identity.kind is Kind.FUSION:
            _write(self.given / CORRECTIONS, _public_pem(key.public_key()), 0o644)
        return files

    def renew(self, identity: Identity, days: int, addresses: Sequence[str] = ()) -> Path:
        """A new certificate for a node's existing key; no other machine needs to be updated.

        `addresses`: of a router that is reached elsewhere from now on; else those of before.
        """
        self._require(identity)
        file = self.folder / f"{identity.stem}.pem"
        before = load_certificate(file)
        public = before.public_key()
        assert isinstance(public, ec.EllipticCurvePublicKey)  # made by this authority
        self._certify(identity, public, days, addresses or _addresses(before))
        return self.given / f"{identity.stem}.pem"

    def revoke(self, identity: Identity) -> None:
        """Remove a node's anchor from the trust file, and its files from this folder."""
        self._require(identity)
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        with writing(self._revoked):
            for path in (*self._anchor_files(identity), self.folder / f"{identity.stem}.pem"):
                path.rename(self._revoked / f"{path.stem}.{stamp}{path.suffix}")
        for path in self.given.glob(f"{identity.stem}.*"):
            path.unlink()
        if identity.kind is Kind.FUSION:
            (self.given / CORRECTIONS).unlink(missing_ok=True)
        self._write_trust()

    def admit(self, anchor: Path) -> Identity:
        """Trust another site's router by adding its anchor; raise InputError if it is not one."""
        certificate = load_certificate(anchor)
        identity = anchored(certificate)
        if identity is None or identity.kind is not Kind.ROUTER:
            name = common_name(certificate)
            raise InputError(f"{anchor} is of «{name}»; only a router's anchor can be admitted")
        _write(self._anchors / f"{identity.site}.{identity.stem}.pem", _pem(certificate), 0o644)
        self._write_trust()
        return identity

    def anchor(self, identity: Identity) -> Path:
        """A node's anchor, for admission by another site."""
        return self._anchor_files(identity)[1]

    def listed(self) -> list[Listed]:
        """Every node that has or had a certificate, admitted ones first."""
        self._check()
        found = [_listed(path, is_revoked=False) for path in self.folder.glob("*-*.pem")]
        found += [_listed(path, is_revoked=True) for path in self._revoked.glob("*.*.pem")]
        known = [one for one in found if one is not None]
        return sorted(known, key=lambda one: (one.is_revoked, one.identity.common_name))

    def strangers(self) -> list[str]:
        """Names in the trust file whose anchors this authority neither signed nor admitted."""
        authority = load_certificate(self.folder / "authority.pem")
        admitted = {_pem(load_certificate(path)) for path in self._anchors.glob("*.*.pem")}
        anchors = load_certificates(self.trust) if self.trust.stat().st_size else []
        return [
            common_name(anchor)
            for anchor in anchors
            if not is_signed_by(anchor, authority) and _pem(anchor) not in admitted
        ]

    def _check(self) -> None:
        if not (self.folder / "authority.pem").exists():
            raise InputError(f"{self.folder} has no authority; `trigpoint secure init` makes it")

    def _require(self, identity: Identity) -> None:
        self._check()
        if not self._anchor_files(identity)[0].exists():
            name, known = f"{identity.kind} {identity.name}", self.listed()
            if any(one.identity == identity for one in known):
                raise InputError(f"{name} was revoked; admit it anew: trigpoint secure node {name}")
            others = [one.identity for one in known if not one.is_revoked]
            names = [f"{other.kind} {other.name}" for other in others]
            raise InputError(f"{name} has no certificate; there are: {', '.join(names) or 'none'}")

    def _anchor_files(self, identity: Identity) -> tuple[Path, Path]:
        self._check()
        stem = self._anchors / identity.stem
        return stem.with_suffix(".key"), stem.with_suffix(".pem")

    def _certify(
        self,
        identity: Identity,
        public: ec.EllipticCurvePublicKey,
        days: int,
        addresses: Sequence[str],
    ) -> None:
        anchor_key = load_key(self._anchor_files(identity)[0])
        certificate = _signed(
            identity.common_name,
            public,
            anchor_name(identity),
            anchor_key,
            timedelta(days=days),
            addresses=addresses,
            serves=identity.kind is Kind.ROUTER,
        )
        for folder in (self.given, self.folder):
            _write(folder / f"{identity.stem}.pem", _pem(certificate), 0o644)

    def _write_trust(self) -> None:
        anchors = sorted(self._anchors.glob("*.pem"))
        _write(self.trust, b"".join(path.read_bytes() for path in anchors), 0o644)


def _signed(
    name: str,
    key: ec.EllipticCurvePrivateKey | ec.EllipticCurvePublicKey,
    issuer: str,
    issuer_key: ec.EllipticCurvePrivateKey,
    lifetime: timedelta,
    *,
    is_authority: bool = False,
    serves: bool = False,
    addresses: Sequence[str] = (),
) -> x509.Certificate:
    """A certificate. `serves`: the accepting side may show it too, not only the connecting one."""
    now = datetime.now(UTC)
    public = key.public_key() if isinstance(key, ec.EllipticCurvePrivateKey) else key
    builder = (
        x509.CertificateBuilder()
        .subject_name(_distinguished(name))
        .issuer_name(_distinguished(issuer))
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + lifetime)
        .add_extension(x509.BasicConstraints(is_authority, None), critical=True)
    )
    if not is_authority:
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
        uses += [ExtendedKeyUsageOID.SERVER_AUTH] if serves else []
        builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    if addresses:
        names = x509.SubjectAlternativeName([_general_name(text) for text in addresses])
        builder = builder.add_extension(names, critical=False)
    return builder.sign(issuer_key, hashes.SHA256())


def _distinguished(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _general_name(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address.strip("[]")))
    except ValueError:
        return x509.DNSName(address)


def _addresses(certificate: x509.Certificate) -> tuple[str, ...]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return tuple(str(name.value) for name in names)


def _listed(path: Path, *, is_revoked: bool) -> Listed | None:
    certificate = load_certificate(path)
    identity = Identity.parse(common_name(certificate))
    if identity is None:
        return None  # a revoked anchor beside its node's certificate
    until, serial = certificate.not_valid_after_utc, f"{certificate.serial_number:x}"
    return Listed(identity, serial, until, _addresses(certificate), is_revoked)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _public_pem(key: ec.EllipticCurvePublicKey) -> bytes:
    return key.public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    )


def _write_key(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    text = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    _write(path, text, 0o600)


def _write(path: Path, data: bytes, mode: int) -> None:
    with writing(path):
        replace_file(path, data, mode=mode)


def _make_folder(path: Path, mode: int) -> None:
    with writing(path):
        path.mkdir(mode=mode, parents=True, exist_ok=True)


def addresses_of(kind: Kind, addresses: Iterable[str]) -> tuple[str, ...]:
    """The addresses in a certificate; only routers have any."""
    given = tuple(dict.fromkeys(addresses))
    if kind is not Kind.ROUTER:
        if given:
            raise InputError(f"--address is for routers; a {kind} is not connected to")
        return ()
    return tuple(dict.fromkeys([*given, *LOOPBACK_NAMES]))
