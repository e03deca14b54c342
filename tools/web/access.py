"""Who may see the page: the address, the host's name, the login, the headers of every answer."""

import hashlib
import hmac
import ipaddress
import socket
import stat
import time
from collections.abc import Collection, Iterable
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from msgspec import Struct
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from trigpoint.base.errors import InputError

LOOPBACK = "127.0.0.1"
COOKIE = "trigpoint-board"
DAY_S = 86400
_LOGIN_S = 30 * DAY_S
"""A login lasts so long after the page was last opened or connected: a wall needs no hand."""
_LEAST_TOKEN = 20
_MOST_TOKEN = 1000

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}


class Access(Struct, frozen=True):
    """Checked. `token`: "" where there is no login; `certificate`, `key`: PEM files of TLS."""

    host: str = LOOPBACK
    names: tuple[str, ...] = ()
    token: str = ""
    certificate: Path | None = None
    key: Path | None = None

    @property
    def is_encrypted(self) -> bool:
        return self.certificate is not None

    @property
    def shown(self) -> str:
        """What a browser asks for: a further name, or the machine's, where `host` is all of its
        addresses, which is none."""
        name, address = self.host, _address(self.host)
        if address is not None and address.is_unspecified:
            name = next((name for name in self.names if name != self.host), socket.gethostname())
        return f"[{name}]" if ":" in name else name


def checked_access(
    host: str,
    *,
    names: Iterable[str],
    token: Path | None,
    certificate: Path | None,
    key: Path | None,
) -> Access:
    """Raise InputError where the page would be open to whoever reaches it."""
    if (certificate is None) != (key is None):
        raise InputError("--certificate and --key belong together; give both")
    if not _is_loopback(host) and (certificate is None or token is None):
        raise InputError(
            f"--host {host}: beyond this machine the page is encrypted and has a login; give "
            "--certificate FILE.pem, --key FILE.key and --token FILE"
        )
    for path in filter(None, (certificate, key)):
        if not path.is_file():
            raise InputError(f"{path}: there is no such file; give a certificate and its key, PEM")
    if key is not None:
        _check_private(key)
    text = "" if token is None else _token(token)
    return Access(host, (host, *names), text, certificate, key)


def _token(path: Path) -> str:
    if not path.is_file():
        raise InputError(
            f"{path}: there is no such token file; make one: (umask 077; openssl rand -hex 32 > "
            f"{path})"
        )
    _check_private(path)
    text = path.read_text(encoding="utf-8", errors="replace").strip()
    if not _LEAST_TOKEN <= len(text) <= _MOST_TOKEN:
        raise InputError(
            f"{path}: a token has {_LEAST_TOKEN} to {_MOST_TOKEN} characters, this has "
            f"{len(text)}; make one: (umask 077; openssl rand -hex 32 > {path})"
        )
    return text


def _check_private(path: Path) -> None:
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise InputError(f"{path} can be read by others (mode {mode:04o}); chmod 600 {path}")


def _is_loopback(host: str) -> bool:
    address = _address(host)
    return host == "localhost" if address is None else address.is_loopback


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return None


class Guard:
    """Decides on requests; `open_paths`: what is given before anybody has logged in."""

    def __init__(self, access: Access, open_paths: Collection[str] = ()) -> None:
        self._access, self._open_paths = access, open_paths
        self._names = {"localhost", socket.gethostname().lower(), *map(str.lower, access.names)}

    def refusal(self, request: Request) -> Response | None:
        """The answer to who may not come in; None for who may."""
        if not self._is_named(request.headers.get("host", "")):
            text = "this page is not asked for by that name; use its address, or give --name"
            return PlainTextResponse(text, 421)
        if request.method == "POST" and not self._is_own_page(request):
            return PlainTextResponse("the request does not come from this page", 403)
        if not self._access.token or request.url.path in self._open_paths or self.is_known(request):
            return None
        if request.url.path == "/":
            return sent_on(request, "/login")
        return PlainTextResponse("log in first", 401, {"WWW-Authenticate": "Bearer"})

    def is_known(self, request: Request) -> bool:
        """Whether a request has shown the token, as a header or by its cookie."""
        scheme, _, given = request.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return self.is_token(given.strip())
        until, _, _ = (cookie := request.cookies.get(COOKIE, "")).partition(".")
        if not until.isdecimal() or len(until) > 12 or int(until) < time.time():
            return False
        return hmac.compare_digest(cookie.encode(), self._cookie(int(until)).encode())

    def is_token(self, given: str) -> bool:
        """Whether a text is the token; takes as long whatever it is."""
        return hmac.compare_digest(given.encode(), self._access.token.encode())

    def let_in(self, response: Response) -> Response:
        """Prolong a login with this answer."""
        if self._access.token:
            value = self._cookie(int(time.time()) + _LOGIN_S)
            response.set_cookie(
                COOKIE, value, max_age=_LOGIN_S, httponly=True, secure=True, samesite="strict"
            )
        return response

    @property
    def headers(self) -> dict[str, str]:
        """What every answer has."""
        lasting = {"Strict-Transport-Security": f"max-age={_LOGIN_S}"}
        return HEADERS | (lasting if self._access.is_encrypted else {})

    def _cookie(self, until: int) -> str:
        """Holds over a restart of the server, and ends where the token is another."""
        mark = hmac.new(self._access.token.encode(), f"{COOKIE} {until}".encode(), hashlib.sha256)
        return f"{until}.{mark.hexdigest()}"

    def _is_named(self, host: str) -> bool:
        """Against DNS rebinding: a foreign name that is made to lead here, which an address is
        not."""
        name = _parts(f"//{host}").hostname or ""
        return name in self._names or _address(name) is not None

    def _is_own_page(self, request: Request) -> bool:
        origin = _parts(request.headers.get("origin", ""))
        is_here = origin.netloc == request.headers.get("host", "") != ""
        return is_here and origin.scheme == request.url.scheme


def sent_on(request: Request, path: str) -> Response:
    """To another path, with what was asked for (`?kiosk`)."""
    return RedirectResponse(str(request.url.replace(scheme="", netloc="", path=path)), 303)


def _parts(address: str) -> SplitResult:
    """A web address's parts; none of one that cannot be read."""
    try:
        return urlsplit(address)
    except ValueError:
        return urlsplit("")
