"""What a secured router and signed corrections cost: `python -m benchmarks relay`.

Processor time of the router's process for each message that it hands from one client to another, in
the clear and with certificates and rules; and of a signature and its check. Processor time, so that
a busy machine tells much the same as one at rest.
"""

import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from cryptography.hazmat.primitives.asymmetric import ec

from benchmarks.timing import worked_s
from trigpoint.base.clock import SystemClock
from trigpoint.bus.bus import Bus
from trigpoint.bus.settings import Settings
from trigpoint.contract.access import Kind
from trigpoint.contract.topics import ODOMETRY
from trigpoint.security.authenticator import CorrectionSigner, CorrectionVerifier
from trigpoint.security.credentials import node_credentials
from trigpoint.site.config import Site, load_site
from trigpoint.zenoh import ZenohBus, open_session
from trigpoint.zenoh.patience import open_patiently

from .bad_links import SITE
from .segments import certify

_MESSAGES = 20_000
_RATE = 2000.0
_BYTES = 730
"""Of an odometry message on the wire."""
_SIGNATURES = 1000
_UP_S = 30.0


def main() -> None:
    """What a secured router and signed corrections cost."""
    for is_secured in (False, True):
        rate, microseconds = relayed(is_secured)
        name = "mutual TLS, rules" if is_secured else "in the clear"
        print(f"router, {name}: {microseconds:.0f} µs of one core a message at {rate:.0f} a second")
    sign, verify = signed()
    print(f"a correction: signed in {1e6 * sign:.0f} µs, checked in {1e6 * verify:.0f} µs")


def relayed(is_secured: bool, port: int = 17555) -> tuple[float, float]:
    """(messages a second that came, µs of the router's processor time for each)."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        listening, connecting = _sites(folder, is_secured, port)
        router = subprocess.Popen(
            [sys.executable, "-m", "trigpoint", "router", "--site", str(listening)],
            stderr=subprocess.DEVNULL,
        )
        stack.callback(router.wait)
        stack.callback(router.terminate)
        site = load_site(connecting)
        fusion = stack.enter_context(_client(site, (Kind.FUSION, "fusion")))
        robot = stack.enter_context(_client(site, (Kind.ROBOT, "r1")))
        return _measured(site, robot, fusion, router.pid)


def _client(site: Site, me: tuple[Kind, str]) -> ZenohBus:
    """As on another machine: on this one, peers would meet without the router."""
    files = node_credentials(site, *me).files if site.bus.tls else None
    settings = Settings("client", connect=site.bus.connect, files=files)
    return ZenohBus(open_patiently(lambda: open_session(settings), settings, _UP_S))


def _measured(site: Site, robot: Bus, fusion: Bus, router: int) -> tuple[float, float]:
    subscription = fusion.subscribe(ODOMETRY, ODOMETRY.expression(site.name))
    publisher = robot.publisher(ODOMETRY, ODOMETRY.key(site.name, "r1"))
    time.sleep(1.0)
    payload = bytes(_BYTES)
    came, before_s, began_s = 0, worked_s(router), time.perf_counter()
    for number in range(_MESSAGES):
        publisher.put(payload)
        while subscription.take(0.0) is not None:
            came += 1
        ahead_s = began_s + (number + 1) / _RATE - time.perf_counter()
        if ahead_s > 0:
            time.sleep(ahead_s)
    while subscription.take(1.0) is not None:
        came += 1
    used_s = worked_s(router) - before_s
    return came / (time.perf_counter() - began_s - 1.0), 1e6 * used_s / came


def _sites(folder: Path, is_secured: bool, port: int) -> tuple[Path, Path]:
    """The router's site file and the others'."""
    protocol, more = ("tls", "[bus.tls]\n") if is_secured else ("tcp", "")
    if is_secured:
        certify(folder, ((Kind.ROBOT, "r1"), (Kind.FUSION, "fusion")))
    paths = []
    for key in ("listen", "connect"):
        path = folder / f"{key}.toml"
        path.write_text(f'{SITE}[bus]\n{key} = ["{protocol}/127.0.0.1:{port}"]\n{more}')
        paths.append(path)
    return paths[0], paths[1]


def signed() -> tuple[float, float]:
    """Processor seconds of one signature and of one check."""
    key = ec.generate_private_key(ec.SECP256R1())
    signer, payload, mark = CorrectionSigner(key, SystemClock()), bytes(500), bytes(24)
    before = time.process_time()
    said = [signer.sign("lab/robot/r1/correction", payload, mark) for _ in range(_SIGNATURES)]
    between = time.process_time()
    verifier = CorrectionVerifier(key.public_key(), since_ns=0)
    for attachment in said:
        verifier.verify("lab/robot/r1/correction", payload, attachment)
    return (between - before) / _SIGNATURES, (time.process_time() - between) / _SIGNATURES
