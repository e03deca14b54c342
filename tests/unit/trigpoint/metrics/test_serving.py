"""/metrics over HTTP: served on loopback, closed with its program, bounded by nobody's patience."""

import socket
import time
import urllib.request
from pathlib import Path

import pytest

from trigpoint.base.errors import ConfigError, OperationError
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.metrics.serving import metrics_served
from trigpoint.site.config import Site, parse_site

CAMERA = 'site = "lab"\n[cameras.c1]\nsource = "sim://c1"\n'
ANY = "127.0.0.1:0"


class Reported:
    reported = Diagnostics(1, (DiagnosticStatus(0, "edge/c1", "", "", {"pictures.total": "3"}),))


def site(text: str = "") -> Site:
    return parse_site(CAMERA + text, directory=Path())


def get(address: str) -> str:
    with urllib.request.urlopen(address, timeout=10.0) as answer:
        return answer.read().decode()


def port_of(address: str) -> int:
    return int(address.rpartition(":")[2].partition("/")[0])


@pytest.mark.parametrize(("text", "at"), [(f'[metrics]\nlisten = "{ANY}"', ""), ("", ANY)])
def test_the_site_file_or_the_command_line_says_where(text: str, at: str) -> None:
    with metrics_served(site(text), at, [Reported()]) as address:
        line = 'trigpoint_pictures_total{camera="c1",node="edge/c1",site="lab"} 3.0'
        assert line in get(address)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port_of(address)), 1.0)


@pytest.mark.parametrize(("text", "at"), [("", ""), (f'[metrics]\nlisten = "{ANY}"', "off")])
def test_nothing_is_served_that_nobody_asked_for(text: str, at: str) -> None:
    with metrics_served(site(text), at, [Reported()]) as address:
        assert address == ""


def test_a_port_that_is_taken_is_said_with_the_remedy() -> None:
    with metrics_served(site(), ANY, []) as address:
        taken = f"127.0.0.1:{port_of(address)}"
        again = metrics_served(site(f'[metrics]\nlisten = "{taken}"'), "", [])
        with pytest.raises(OperationError, match=f"at {taken} .*--metrics HOST:PORT"), again:
            pass


@pytest.mark.parametrize("listen", ["9464", "localhost:99999", "0.0.0.0:9464", "[::]:9464"])
def test_a_wrong_or_open_address_is_refused(listen: str) -> None:
    with pytest.raises(ConfigError, match=r"127\.0\.0\.1"):
        site(f'[metrics]\nlisten = "{listen}"')
    with (
        pytest.raises(ConfigError, match=r"--metrics: .*127\.0\.0\.1"),
        metrics_served(site(), listen, []),
    ):
        pass
    if listen.endswith(":9464"):
        assert site(f'[metrics]\nlisten = "{listen}"\ninsecure = true').metrics.listen == listen


def test_a_client_that_says_nothing_holds_up_neither_others_nor_the_end() -> None:
    with metrics_served(site(), ANY, [Reported()]) as address:
        silent = socket.create_connection(("127.0.0.1", port_of(address)))
        assert "trigpoint_pictures_total" in get(address)
        another = socket.create_connection(("127.0.0.1", port_of(address)))
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 10.0
    silent.close()
    another.close()
