"""Who may see the page."""

import socket
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from support.builders import make_site
from support.site.board_desk import served_board

from trigpoint.base.errors import InputError
from trigpoint.tools.web.access import Access, checked_access

TOKEN = "0123456789abcdef0123456789abcdef"


def token_file(folder: Path, text: str = TOKEN, mode: int = 0o600) -> Path:
    path = folder / "token"
    path.write_text(text + "\n", encoding="utf-8")
    path.chmod(mode)
    return path


def certificate(folder: Path) -> tuple[Path, Path]:
    """A self-signed certificate of 127.0.0.1 and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "board")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), False
        )
        .sign(key, hashes.SHA256())
    )
    paths = folder / "board.pem", folder / "board.key"
    paths[0].write_bytes(made.public_bytes(serialization.Encoding.PEM))
    paths[1].write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    paths[1].chmod(0o600)
    return paths


def checked(
    host: str = "127.0.0.1",
    *,
    token: Path | None = None,
    certificate: Path | None = None,
    key: Path | None = None,
) -> Access:
    return checked_access(host, names=(), token=token, certificate=certificate, key=key)


@pytest.mark.parametrize(
    ("host", "names", "shown"),
    [
        ("127.0.0.1", ("board.lab",), "127.0.0.1"),
        ("::1", (), "[::1]"),
        ("0.0.0.0", ("board.lab", "other"), "board.lab"),
        ("::", (), socket.gethostname()),
    ],
)
def test_the_address_that_is_said_is_one_that_a_browser_opens(
    host: str, names: tuple[str, ...], shown: str
) -> None:
    assert Access(host, (host, *names)).shown == shown


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "board.example.com"])
def test_beyond_this_machine_it_is_encrypted_and_has_a_login(host: str, tmp_path: Path) -> None:
    pem, key = certificate(tmp_path)
    token = token_file(tmp_path)
    for given in ({}, {"token": token}, {"certificate": pem, "key": key}):
        with pytest.raises(InputError, match="encrypted and has a login"):
            checked(host, **given)
    assert checked(host, token=token, certificate=pem, key=key).token == TOKEN


def test_on_this_machine_nothing_is_needed() -> None:
    for host in ("127.0.0.1", "localhost", "::1"):
        assert checked(host).token == ""


def test_a_secret_that_others_can_read_is_none(tmp_path: Path) -> None:
    token = token_file(tmp_path, mode=0o640)
    with pytest.raises(InputError, match="chmod 600"):
        checked(token=token)
    pem, key = certificate(tmp_path)
    key.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        checked(certificate=pem, key=key)


def test_a_token_that_can_be_guessed_is_refused(tmp_path: Path) -> None:
    for text in ("", "secret"):
        token = token_file(tmp_path, text)
        with pytest.raises(InputError, match="openssl rand"):
            checked(token=token)


def test_a_certificate_goes_with_its_key(tmp_path: Path) -> None:
    pem, key = certificate(tmp_path)
    with pytest.raises(InputError, match="give both"):
        checked(certificate=pem)
    with pytest.raises(InputError, match="no such file"):
        checked(certificate=tmp_path / "none.pem", key=key)


def test_a_key_of_another_certificate_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "other").mkdir()
    pem, _ = certificate(tmp_path)
    _, key = certificate(tmp_path / "other")
    access = checked(certificate=pem, key=key)
    with (
        pytest.raises(InputError, match="belong together"),
        served_board(make_site(), monkeypatch, access=access),
    ):
        pass


def test_every_answer_has_the_headers(monkeypatch: pytest.MonkeyPatch) -> None:
    with served_board(make_site(), monkeypatch) as desk:
        for path, status in (("/", 200), ("/board.js", 200), ("/none", 404), ("/past?at=1", 200)):
            answer = desk.ask(path)
            assert answer.status == status
            policy = answer.headers["content-security-policy"]
            assert "default-src 'self'" in policy
            assert "unsafe" not in policy
            assert "frame-ancestors 'none'" in policy
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["referrer-policy"] == "no-referrer"
            assert "cache-control" in answer.headers
            assert "server" not in answer.headers


def test_a_foreign_name_that_leads_here_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    access = Access(names=("board.lab.example",))
    with served_board(make_site(), monkeypatch, access=access) as desk:
        for name in ("evil.example", "evil.example:80", "", "127.0.0.1.evil.example", "[::1"):
            assert desk.ask("/", Host=name).status in (400, 421), name
        for name in ("127.0.0.1", f"localhost:{desk.port}", "[::1]:80", "board.lab.example"):
            assert desk.ask("/", Host=name).status == 200, name


def test_nothing_leads_to_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    with served_board(make_site(), monkeypatch) as desk:
        for path in (
            "/../../../../etc/passwd",
            "/..%2f..%2f..%2fetc%2fpasswd",
            "/page/board.js",
            "/board.html",
            "/camera/..%2f..%2fetc/picture/1",
            "/camera/c1/picture/..%2f",
            "//etc/passwd",
        ):
            assert desk.ask(path).status == 404, path
        assert desk.ask("/camera/c9/look").status == 404
        assert desk.ask("/camera/c1/look?after=-1").status == 400
        assert desk.ask("/past?at=now").status == 400
        assert desk.ask("/past?at=nan").status == 400


def test_what_only_reads_takes_no_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    with served_board(make_site(), monkeypatch) as desk:
        own = f"http://127.0.0.1:{desk.port}"
        for path in ("/command/fusion/reset", "/command/camera/c1/snapshot"):
            assert desk.ask(path, "POST", Origin=own).status == 404
        assert desk.ask("/", "POST", Origin=own).status == 405
        assert desk.ask("/", "POST").status == 403


def test_a_login_is_asked_for_and_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trigpoint.tools.board.app._LOGIN_DELAY_S", 0.05)
    with served_board(make_site(), monkeypatch, access=Access(token=TOKEN)) as desk:
        assert desk.ask("/").headers["location"] == "/login"
        for path in ("/events", "/past?at=1", "/metrics", "/board.js", "/camera/c1/look"):
            assert desk.ask(path).status == 401, path
        assert b"<form" in desk.ask("/login").body
        assert desk.ask("/login", "POST", body=f"token={TOKEN}", Origin="http://evil").status == 403
        own = {"Origin": f"http://127.0.0.1:{desk.port}"}
        for wrong in (TOKEN[:-1], "", TOKEN + "0", "é"):
            answer = desk.ask("/login", "POST", body=f"token={wrong}", **own)
            assert answer.status == 401
            assert "set-cookie" not in answer.headers
        answer = desk.ask("/login", "POST", body=f"token={TOKEN}", **own)
        assert answer.status == 303
        given = answer.headers["set-cookie"]
        assert all(word in given for word in ("HttpOnly", "Secure", "SameSite=strict"))
        assert TOKEN not in given
        cookie = given.partition(";")[0]
        assert desk.ask("/board.js", Cookie=cookie).status == 200
        assert desk.ask("/metrics", Authorization=f"Bearer {TOKEN}").status == 200
        assert desk.ask("/metrics", Authorization="Bearer other").status == 401
        name, _, value = cookie.partition("=")
        until, _, mark = value.partition(".")
        for forged in (f"{int(until) + 1}.{mark}", f"1.{mark}", until, "", f"{'9' * 13}.{mark}"):
            assert desk.ask("/board.js", Cookie=f"{name}={forged}").status == 401, forged
    with served_board(make_site(), monkeypatch, access=Access(token=TOKEN)) as desk:
        assert desk.ask("/board.js", Cookie=cookie).status == 200  # a wall needs no hand
    with served_board(make_site(), monkeypatch, access=Access(token=TOKEN[::-1])) as desk:
        assert desk.ask("/board.js", Cookie=cookie).status == 401


def test_it_is_served_by_tls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pem, key = certificate(tmp_path)
    token = token_file(tmp_path)
    access = checked(token=token, certificate=pem, key=key)
    with served_board(make_site(), monkeypatch, access=access) as desk:
        assert desk.address.startswith("https://")
        answer = desk.ask("/login")
        assert answer.status == 200
        assert "max-age" in answer.headers["strict-transport-security"]
        assert desk.ask("/events").status == 401
