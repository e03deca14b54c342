"""The commands `secure`: what they write, with which rights, and what they refuse."""

import json
import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from support.builders import site_text
from support.commands import Cli

from trigpoint.base.errors import ConfigError
from trigpoint.contract.access import Kind
from trigpoint.security.credentials import (
    first_complaint,
    least_days,
    load_certificate,
    load_certificates,
    node_credentials,
    person_credentials,
    trusted,
)
from trigpoint.site.config import load_site

BUS = 'listen = ["tls/127.0.0.1:7447"]\n[bus.tls]'


Secure = Callable[..., str]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    path = tmp_path / "site.toml"
    path.write_text(site_text(bus=BUS, cameras=2))
    return path


@pytest.fixture
def secure(site: Path, cli: Cli) -> Secure:
    """Runs a command on the site, which has an authority, and gives what it says."""

    def run(*words: object, at: Path = site, status: int = 0) -> str:
        return cli("secure", *words, "--site", at, status=status).out

    run("init")
    return run


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def names(site: Path) -> list[str]:
    return sorted(one.common_name for one in trusted(site.parent / "secure" / "trust.pem"))


def test_keys_are_their_owners_alone(site: Path, secure: Secure) -> None:
    secure("node", "camera", "c1")
    folder = site.parent
    for key in (*folder.rglob("*.key"),):
        assert mode(key) == 0o600, key
    assert {mode(folder / "authority" / name) for name in ("anchors", "revoked")} == {0o700}


def test_node_is_named_in_its_certificate_and_admitted(site: Path, secure: Secure) -> None:
    for words in (("camera", "c1"), ("fusion", "fusion"), ("operator", "anna")):
        secure("node", *words)
    assert names(site) == ["lab/camera/c1", "lab/fusion/fusion", "lab/operator/anna"]
    loaded = load_site(site)
    assert node_credentials(loaded, Kind.CAMERA, "c1").identity.common_name == "lab/camera/c1"
    assert person_credentials(loaded).identity.name == "anna"
    assert (site.parent / "secure" / "corrections.pem").exists()


def test_only_a_routers_certificate_serves(site: Path, secure: Secure) -> None:
    secure("node", "camera", "c1")
    secure("node", "router", "hall", "--address", "10.0.0.1", "--address", "hub.example.org")
    uses = {}
    for stem in ("camera-c1", "router-hall"):
        certificate = load_certificate(site.parent / "secure" / f"{stem}.pem")
        use = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        uses[stem] = ExtendedKeyUsageOID.SERVER_AUTH in use
    assert uses == {"camera-c1": False, "router-hall": True}
    found = load_certificate(site.parent / "secure" / "router-hall.pem")
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    told = {str(name.value) for name in names}
    assert told == {"10.0.0.1", "hub.example.org", "localhost", "127.0.0.1", "::1"}


def test_revoked_node_is_not_trusted_and_may_be_made_anew(site: Path, secure: Secure) -> None:
    secure("node", "camera", "c1")
    secure("node", "camera", "c2")
    before = load_certificates(site.parent / "secure" / "trust.pem")
    secure("revoke", "camera", "c1")
    assert names(site) == ["lab/camera/c2"]
    assert not (site.parent / "secure" / "camera-c1.key").exists()
    secure("node", "camera", "c1")
    after = load_certificates(site.parent / "secure" / "trust.pem")
    assert names(site) == ["lab/camera/c1", "lab/camera/c2"]
    assert len(set(before) & set(after)) == 1
    rows = json.loads(secure("list", "--json"))
    assert [(row["name"], row["state"]) for row in rows] == [
        ("lab/camera/c1", "ok"),
        ("lab/camera/c2", "ok"),
        ("lab/camera/c1", "revoked"),
    ]


def test_renewed_certificate_is_for_the_same_key_and_anchor(site: Path, secure: Secure) -> None:
    secure("node", "camera", "c1", "--days", "10")
    folder = site.parent / "secure"
    before, trust = load_certificate(folder / "camera-c1.pem"), (folder / "trust.pem").read_bytes()
    credentials = node_credentials(load_site(site), Kind.CAMERA, "c1")
    assert least_days([credentials]) == pytest.approx(10.0, abs=0.1)
    assert "runs out in 9 days; trigpoint secure renew camera c1" in first_complaint([credentials])
    secure("renew", "camera", "c1")
    after = load_certificate(folder / "camera-c1.pem")
    assert after.public_key() == before.public_key()
    assert after.serial_number != before.serial_number
    assert after.not_valid_after_utc - datetime.now(UTC) > timedelta(days=364)
    assert (folder / "trust.pem").read_bytes() == trust
    assert first_complaint([credentials]) == ""
    assert least_days([credentials]) == pytest.approx(365.0, abs=1.1)


def test_router_that_moves_is_renewed_for_its_new_address(site: Path, secure: Secure) -> None:
    secure("node", "router", "hall", "--address", "10.0.0.1")
    trust = (site.parent / "secure" / "trust.pem").read_bytes()
    secure("renew", "router", "hall")
    assert "lab/router/hall, reached at 10.0.0.1 localhost" in secure("list")
    secure("renew", "router", "hall", "--address", "10.0.0.2")
    assert "lab/router/hall, reached at 10.0.0.2 localhost" in secure("list")
    assert (site.parent / "secure" / "trust.pem").read_bytes() == trust


def test_list_tells_of_an_anchor_that_was_smuggled_in(
    site: Path, secure: Secure, tmp_path: Path
) -> None:
    secure("node", "camera", "c1")
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "site.toml"
    other.write_text(site_text(bus=BUS))
    secure("init", at=other)
    secure("node", "operator", "mallory", at=other)
    trust = site.parent / "secure" / "trust.pem"
    trust.write_bytes(trust.read_bytes() + (other.parent / "secure" / "trust.pem").read_bytes())
    assert "«anchor lab/operator/mallory» is in" in secure("list", status=1)


def test_only_another_sites_router_is_admitted(site: Path, secure: Secure, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "site.toml"
    other.write_text(site_text(name="hall", bus=BUS))
    secure("init", at=other)
    secure("node", "router", "hub", at=other)
    secure("node", "camera", "c1", at=other)
    anchors = other.parent / "authority" / "anchors"
    secure("admit", str(anchors / "camera-c1.pem"), status=2)
    secure("admit", str(anchors / "router-hub.pem"))
    assert names(site) == ["hall/router/hub"]
    secure("list")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("node", "camera", "c9"), "there is no camera «c9»"),
        (("node", "operator", "Anna"), "the operator's name «Anna» must match"),
        (("node", "fusion", "other"), "a site's fusion is called «fusion»"),
        (("node", "camera", "c1", "--address", "10.0.0.1"), "--address is for routers"),
        (("node", "operator", "a" * 60), "is too long a name"),
        (("renew", "camera", "c1"), "camera c1 has no certificate; there are: none"),
        (("revoke", "viewer", "bob"), "viewer bob has no certificate"),
        (("init",), "has an authority already"),
        (("list", "--authority", "elsewhere"), "elsewhere has no authority"),
    ],
)
def test_wrong_use_is_told_in_one_line(
    site: Path, secure: Secure, cli: Cli, words: tuple[str, ...], expected: str
) -> None:
    assert expected in cli.refused("secure", *words, "--site", site)


def test_revoked_certificate_is_said_to_be_so(site: Path, secure: Secure, cli: Cli) -> None:
    secure("node", "camera", "c1")
    secure("revoke", "camera", "c1")
    for word in ("renew", "revoke"):
        said = cli.refused("secure", word, "camera", "c1", "--site", site)
        assert "camera c1 was revoked; admit it anew: trigpoint secure node camera c1" in said


def test_certificate_of_somebody_else_is_refused(site: Path, secure: Secure) -> None:
    secure("node", "camera", "c1")
    secure("node", "camera", "c2")
    folder = site.parent / "secure"
    (folder / "camera-c2.pem").replace(folder / "camera-c1.pem")
    with pytest.raises(ConfigError, match="is the certificate of «lab/camera/c2»"):
        node_credentials(load_site(site), Kind.CAMERA, "c1")


def test_zenoh_reads_the_configuration_for_zenohd(
    site: Path, secure: Secure, tmp_path: Path
) -> None:
    secure("node", "router", "hall")
    secure("node", "camera", "c1")
    written = tmp_path / "router.json5"
    secure("router", "--out", str(written))
    config = zenoh.Config.from_file(str(written))
    assert json.loads(config.get_json("mode")) == "router"
    assert json.loads(config.get_json("access_control/default_permission")) == "deny"
    assert json.loads(config.get_json("transport/link/tls/enable_mtls")) is True
    subjects = json.loads(config.get_json("access_control/subjects"))
    assert ["lab/camera/c1"] in [subject.get("cert_common_names") for subject in subjects]
