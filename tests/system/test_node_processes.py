"""A node's life as a process of its own."""

import json
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.builders import eventually, make_site, site_text

from trigpoint.zenoh import ZenohBus, open_bus

NODE = """
import sys
from pathlib import Path
from trigpoint import cli
from trigpoint.zenoh import open_bus
from trigpoint.site.config import load_site
from trigpoint.node.node import Node, stopped_by_signals

path = Path(sys.argv[1])

def main() -> None:
    site = load_site(path)
    with open_bus(site) as bus:
        node = Node(bus, site=site.name, kind="edge", name="c1")
        with stopped_by_signals(node):
            bus.serve("lab/clock", lambda payload: payload)
            node.thread("works", lambda: node.stopping.wait())
            node.wait()

cli.COMMANDS["edge"] = cli.Command("__main__:main", "A node.", service=True)
sys.argv[1:] = ["edge"]
cli.main()
"""

TOKEN = "lab/alive/edge/c1"


@pytest.fixture
def bus(stack: ExitStack) -> ZenohBus:
    return stack.enter_context(open_bus(make_site(bus='listen = ["tcp/127.0.0.1:0"]')))


@pytest.fixture
def site_file(bus: ZenohBus, tmp_path: Path) -> Path:
    path = tmp_path / "site.toml"
    path.write_text(site_text(bus=f"connect = {json.dumps(bus.locators)}"))
    return path


def start(stack: ExitStack, site_file: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", NODE, str(site_file)], stderr=subprocess.PIPE, text=True
    )
    stack.callback(process.communicate)
    stack.callback(process.kill)
    return process


def test_told_to_stop_a_node_ends_in_order(
    stack: ExitStack, bus: ZenohBus, site_file: Path
) -> None:
    process = start(stack, site_file)
    assert eventually(lambda: bus.alive(TOKEN) == [TOKEN])
    process.send_signal(signal.SIGTERM)
    _, log = process.communicate(timeout=60)
    assert process.returncode == 0, log
    assert "edge/c1 stopped" in log
    assert eventually(lambda: bus.alive(TOKEN) == [])


def test_second_process_of_the_same_identity_exits_1_with_one_line(
    stack: ExitStack, bus: ZenohBus, site_file: Path
) -> None:
    start(stack, site_file)
    assert eventually(lambda: bus.alive(TOKEN) == [TOKEN])
    second = start(stack, site_file)
    _, log = second.communicate(timeout=60)
    assert second.returncode == 1
    assert log == (
        "trigpoint: edge/c1 already runs on site lab; "
        "stop that one first, or give this one another name\n"
    )


def test_killed_node_starts_again_under_its_name(
    stack: ExitStack, bus: ZenohBus, site_file: Path
) -> None:
    first = start(stack, site_file)
    assert eventually(lambda: bus.alive(TOKEN) == [TOKEN])
    first.kill()
    first.wait()
    second = start(stack, site_file)
    assert eventually(lambda: bus.alive(TOKEN) == [] or second.poll() is not None)
    assert eventually(lambda: bus.alive(TOKEN) == [TOKEN])
    assert second.poll() is None


def test_program_whose_bus_is_left_open_still_ends() -> None:
    code = (
        "from support.builders import make_site; from trigpoint.zenoh import open_bus;"
        "from trigpoint.contract.topics import ODOMETRY;"
        "bus = open_bus(make_site(bus='listen = [\"tcp/127.0.0.1:0\"]'));"
        "bus.subscribe(ODOMETRY, 'lab/robot/*/odom'); bus.serve('lab/clock', bytes)"
    )
    environment = {"PYTHONPATH": ":".join(sys.path)}
    process = subprocess.run([sys.executable, "-c", code], env=environment, timeout=60, check=False)
    assert process.returncode == 0
