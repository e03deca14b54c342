"""A correction is believed once, and only where fusion's key signed it for this robot."""

from pathlib import Path
from uuid import UUID

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given, settings
from hypothesis import strategies as st
from support.builders import make_site

from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import ConfigError, MessageError
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.security.authenticator import (
    CorrectionSigner,
    CorrectionVerifier,
    correction_signer,
    correction_verifier,
)
from trigpoint.site.config import parse_site

KEY = "lab/robot/r1/correction"
FUSION = ec.generate_private_key(ec.SECP256R1())
STRANGER = ec.generate_private_key(ec.SECP256R1())
NOW_NS = 1_800_000_000_000_000_000
MARK = encode_mark(CorrectionMark(UUID(int=1), 7))


def signer(key: ec.EllipticCurvePrivateKey = FUSION, now_ns: int = NOW_NS) -> CorrectionSigner:
    return CorrectionSigner(key, ManualClock(now_ns))


def verifier(since_ns: int = NOW_NS - 1) -> CorrectionVerifier:
    return CorrectionVerifier(FUSION.public_key(), since_ns=since_ns)


def test_what_fusion_signed_is_believed() -> None:
    fusion, bridge = signer(), verifier()
    for payload in (b"here", b"there", b"here"):  # in the same nanosecond
        assert bridge.verify(KEY, payload, fusion.sign(KEY, payload, MARK)) == MARK


@pytest.mark.parametrize("length", [0, 24, 95, 97])
def test_attachment_without_a_signature_is_refused(length: int) -> None:
    with pytest.raises(MessageError, match=f"{length} bytes; it needs 96"):
        verifier().verify(KEY, b"here", bytes(length))


def test_strangers_signature_is_refused() -> None:
    with pytest.raises(MessageError, match="is not fusion's"):
        verifier().verify(KEY, b"here", signer(STRANGER).sign(KEY, b"here", MARK))


@settings(max_examples=40)
@given(st.integers(0, 95), st.integers(1, 255))
def test_attachment_changed_anywhere_is_refused(place: int, change: int) -> None:
    attachment = bytearray(signer().sign(KEY, b"here", MARK))
    attachment[place] ^= change
    with pytest.raises(MessageError, match="is not fusion's"):
        verifier().verify(KEY, b"here", bytes(attachment))


def test_other_payload_or_robot_is_refused() -> None:
    attachment = signer().sign(KEY, b"here", MARK)
    for key, payload in ((KEY, b"there"), ("lab/robot/r2/correction", b"here")):
        with pytest.raises(MessageError, match="is not fusion's"):
            verifier().verify(key, payload, attachment)


def test_parts_cannot_be_shifted_into_each_other() -> None:
    attachment = signer().sign(KEY, b"ab", MARK)
    with pytest.raises(MessageError, match="is not fusion's"):
        verifier().verify(KEY + "a", b"b", attachment)


def test_replay_is_refused() -> None:
    fusion, bridge = signer(), verifier()
    first = fusion.sign(KEY, b"here", MARK)
    second = fusion.sign(KEY, b"there", MARK)
    bridge.verify(KEY, b"here", first)
    bridge.verify(KEY, b"there", second)
    for payload, attachment in ((b"there", second), (b"here", first)):
        with pytest.raises(MessageError, match="said again"):
            bridge.verify(KEY, payload, attachment)


def test_refused_correction_does_not_silence_fusion() -> None:
    fusion, bridge = signer(), verifier()
    ahead = signer(STRANGER, NOW_NS * 2).sign(KEY, b"here", MARK)
    with pytest.raises(MessageError):
        bridge.verify(KEY, b"here", ahead)
    assert bridge.verify(KEY, b"here", fusion.sign(KEY, b"here", MARK)) == MARK


def test_what_was_signed_before_the_bridge_began_is_refused() -> None:
    attachment = signer().sign(KEY, b"here", MARK)
    with pytest.raises(MessageError, match="before the last one or the bridge's start"):
        verifier(since_ns=NOW_NS).verify(KEY, b"here", attachment)


def test_clock_that_is_set_back_does_not_stop_a_running_fusion() -> None:
    clock = ManualClock(NOW_NS)
    fusion, bridge = CorrectionSigner(FUSION, clock), verifier()
    bridge.verify(KEY, b"here", fusion.sign(KEY, b"here", MARK))
    fusion._clock = ManualClock(NOW_NS - 10**12)
    assert bridge.verify(KEY, b"there", fusion.sign(KEY, b"there", MARK)) == MARK


def test_site_without_tls_signs_nothing() -> None:
    site, clock = make_site(), ManualClock(NOW_NS)
    attachment = correction_signer(site, clock).sign(KEY, b"here", MARK)
    assert attachment == MARK
    assert correction_verifier(site, clock).verify(KEY, b"here", attachment) == MARK


def test_missing_key_of_a_secured_site_is_told(tmp_path: Path) -> None:
    from support.builders import site_text

    text = site_text(bus='listen = ["tls/127.0.0.1:7447"]\n[bus.tls]')
    site = parse_site(text, directory=tmp_path)
    with pytest.raises(ConfigError, match=r"fusion-fusion\.key is not there"):
        correction_signer(site, ManualClock(NOW_NS))
    with pytest.raises(ConfigError, match=r"corrections\.pem is not there"):
        correction_verifier(site, ManualClock(NOW_NS))
