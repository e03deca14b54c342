"""Signs corrections, so that only fusion can have made them: a signature follows the mark.

The rules of the bus (`access`) let only fusion publish corrections. The signature protects where
they cannot: against a process on a relaying machine, and against a replayed correction. On a site
without `[bus.tls]` the attachment is the mark alone, and nothing is checked.
"""

import struct
from typing import TYPE_CHECKING, Protocol

from trigpoint.base.clock import Clock, to_seconds
from trigpoint.base.errors import ConfigError, MessageError
from trigpoint.contract.correction import MARK_LENGTH
from trigpoint.site.config import Site

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric import ec

_COUNTER = struct.Struct("<Q")
_SIDE = 32
"""Bytes of each of r and s, the two numbers of a P-256 signature (FIPS 186-5)."""
LENGTH = _COUNTER.size + 2 * _SIDE
_DOMAIN = b"trigpoint correction 1"


class Signer(Protocol):
    """Fusion's side."""

    def sign(self, key: str, payload: bytes, attachment: bytes) -> bytes:
        """The attachment with its authenticator, for a correction on `key`."""
        ...


class Verifier(Protocol):
    """The bridge's side."""

    def verify(self, key: str, payload: bytes, attachment: bytes) -> bytes:
        """The attachment without its authenticator; raise MessageError if that is wrong."""
        ...


def correction_signer(site: Site, clock: Clock) -> Signer:
    """The signer of a site's corrections; raise ConfigError if fusion's key is not here."""
    if site.bus.tls is None:
        return _Plain()
    from trigpoint.security import (
        credentials,
    )

    path = credentials.directory(site) / "fusion-fusion.key"
    if not path.exists():
        raise ConfigError(f"{path} is not there; corrections cannot be signed without it")
    return CorrectionSigner(credentials.load_key(path), clock)


def correction_verifier(site: Site, clock: Clock) -> Verifier:
    """The verifier of a site's corrections; raise ConfigError if fusion's public key is missing."""
    if site.bus.tls is None:
        return _Plain()
    from trigpoint.security import credentials

    path = credentials.directory(site) / credentials.CORRECTIONS
    if not path.exists():
        raise ConfigError(
            f"{path} is not there, so no correction could be believed; copy it here from where "
            "the site's authority is"
        )
    return CorrectionVerifier(credentials.load_public_key(path), since_ns=clock.now_ns())


class CorrectionSigner:
    """Signs with an increasing counter: the clock's nanoseconds, or one above the last."""

    def __init__(self, key: "ec.EllipticCurvePrivateKey", clock: Clock) -> None:
        self._key, self._clock, self._last = key, clock, 0

    def sign(self, key: str, payload: bytes, attachment: bytes) -> bytes:
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

        self._last = max(self._clock.now_ns(), self._last + 1)
        signed = attachment + _COUNTER.pack(self._last)
        der = self._key.sign(_statement(key, payload, signed), ec.ECDSA(hashes.SHA256()))
        sides = [side.to_bytes(_SIDE, "big") for side in decode_dss_signature(der)]
        return signed + b"".join(sides)


class CorrectionVerifier:
    """Checks one robot's corrections in order of arrival. Not thread-safe.

    `since_ns`: Unix time; anything signed earlier is rejected, because the previous bridge may have
    accepted it already. So each correction is accepted once, whoever sends it.
    """

    def __init__(self, key: "ec.EllipticCurvePublicKey", *, since_ns: int) -> None:
        self._key, self._last = key, since_ns

    def verify(self, key: str, payload: bytes, attachment: bytes) -> bytes:
        mark = attachment[:MARK_LENGTH]
        if len(attachment) != MARK_LENGTH + LENGTH:
            raise MessageError(
                f"a correction's attachment has {len(attachment)} bytes; it needs "
                f"{MARK_LENGTH + LENGTH}: in a secured site fusion signs its corrections"
            )
        signed, sides = attachment[: -2 * _SIDE], attachment[-2 * _SIDE :]
        if not self._is_genuine(_statement(key, payload, signed), sides):
            raise MessageError("a correction's signature is not fusion's")
        (counter,) = _COUNTER.unpack(signed[MARK_LENGTH:])
        if counter <= self._last:
            age_s = to_seconds(self._last - counter)
            raise MessageError(
                f"a correction was signed {age_s:.3f} s before the last one or the bridge's start: "
                "it is said again, or fusion's clock was set back (then restart the bridge)"
            )
        self._last = counter
        return mark

    def _is_genuine(self, statement: bytes, sides: bytes) -> bool:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

        r, s = int.from_bytes(sides[:_SIDE], "big"), int.from_bytes(sides[_SIDE:], "big")
        try:
            der = encode_dss_signature(r, s)
            self._key.verify(der, statement, ec.ECDSA(hashes.SHA256()))
        except (InvalidSignature, ValueError):
            return False
        return True


class _Plain:
    """For a site that is not secured."""

    def sign(self, key: str, payload: bytes, attachment: bytes) -> bytes:
        del key, payload
        return attachment

    def verify(self, key: str, payload: bytes, attachment: bytes) -> bytes:
        del key, payload
        return attachment


def _statement(key: str, payload: bytes, attachment: bytes) -> bytes:
    """The signed bytes: each part is preceded by its length, so that no two inputs coincide."""
    parts = (_DOMAIN, key.encode(), attachment, payload)
    return b"".join(len(part).to_bytes(4, "little") + part for part in parts)
