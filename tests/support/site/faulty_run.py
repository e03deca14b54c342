"""A run under fire from its first program to its last."""

import threading
import time
from contextlib import ExitStack
from pathlib import Path

import msgspec
import numpy as np
from support.builders import eventually
from support.fusion.drives import lab_plan, make_session, pushed
from support.fusion.networks import apart_sigmas
from support.site.faults import MORE, Fire, Watchman, kill_and_restart
from support.site.programs import Drive, Field, Program, answers, lay_out, meeting_point

from trigpoint.bus.bus import Bus
from trigpoint.contract import cdr, topics
from trigpoint.fusion.checkpoint import read_checkpoint
from trigpoint.fusion.inputs import load_inputs
from trigpoint.map.network import Network, load_network
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.site.state import NodeStatus
from trigpoint.tools.site.status import look, wanted_of

MOST_MB = 450.0
"""Fusion with its solver takes 250 MB before the first message, and 600 under a flood once."""

_COUNTED = (
    "rejected",
    *(f"left_out.{r}" for r in ("unknown_sender", "two_senders", "unknown_target")),
)


def assert_site_stays_undisturbed(folder: Path, port: int, *, seconds: float, seed: int) -> None:
    """Drive for so long under fire; raises AssertionError where anything goes wrong."""
    session = make_session(lab_plan("charuco", seconds=seconds))
    other = msgspec.structs.replace(target_of("checkerboard"), name="another")
    (folder / "other.toml").write_text(target_text(other))
    field = lay_out(folder, port, session, more=MORE)
    programs: list[Program] = []

    def start(*words: str) -> Program:
        program = Program(field, *words)
        programs.append(program)
        return program

    with ExitStack() as stack:
        stack.callback(lambda: [program.kill() for program in programs])
        bus = stack.enter_context(meeting_point(field))
        start("record", "--out", str(field.folder / "session"))
        fusion = start("fusion", "--out", str(field.out))
        assert eventually(lambda: answers(bus, "clock") is not None, 60.0), fusion.said
        drive = Drive(field)
        stack.callback(drive.close)
        watchman = Watchman(bus, lambda: list(programs))
        stack.callback(watchman.close)
        fire = Fire(field, drive, seed)
        stack.callback(fire.close)
        fire.start()
        time.sleep(seconds * 0.4)
        watchman.is_paused.set()
        programs.remove(fusion)
        fusion = kill_and_restart(fusion, field, lambda: start("fusion", "--out", str(field.out)))
        assert eventually(lambda: answers(bus, "fusion/map") is not None, 60.0), fusion.said
        watchman.is_paused.clear()
        before = fire.done.copy()
        drive.finish()
        # However long the restart took: who is started again meets every attack as well.
        assert eventually(lambda: fire.is_all_done_since(before)), (before, fire.done)
        fire.close()
        check_status(field, fusion)
        assert eventually(lambda: is_settled(field, bus), 60.0), fusion.said
        watchman.close()
        check_stops(programs)
        assert watchman.asked > seconds / 2
        assert not watchman.unanswered, (watchman.unanswered, fusion.said)
        assert max(watchman.most_mb.values()) < MOST_MB, watchman.most_mb
        check_network(network_of(field, fusion), drive.undisturbed(), fusion)


def check_status(field: Field, fusion: Program) -> None:
    """`status` says who is there, and what is wrong with what comes in."""
    nodes: dict[str, NodeStatus] = {}

    def is_heard() -> bool:
        with field.session_of_bus() as bus:
            status = look(bus, "lab", threading.Event(), wanted=wanted_of(field.site))
        nodes.update((node.name, node) for node in status.nodes)
        return all(nodes[name].uptime_s > 0 for name in ("fusion/fusion", "recorder/main"))

    def is_all_counted() -> bool:  # what it counts it says once a second
        return is_heard() and all(
            nodes["fusion/fusion"].totals.get(name, 0) > 0 for name in _COUNTED
        )

    assert eventually(is_all_counted), (nodes, fusion.said)
    assert nodes["edge/noisy"].state == "missing"
    # One of its lives at least; how often it was done before and after the kill is drawn.
    said = "".join(log.read_text() for log in field.folder.glob("fusion-*.log"))
    assert "is stamped 3600 s ahead of this machine's clock" in said
    assert "two send on lab/camera/twice/sightings: the sessions" in said


def is_settled(field: Field, bus: Bus) -> bool:
    """Whether fusion has used all that the drive's cameras saw."""
    answer = answers(bus, "fusion/network")
    if answer is None:
        return False
    cameras = {n: c for n, c in answer["cameras"].items() if n in field.session.plan.cameras}
    return all(camera["status"] == "located" for camera in cameras.values())


def check_stops(programs: list[Program]) -> None:
    """Each ends by itself, and in order."""
    for program in reversed(programs):
        assert program.stop() >= 0, program.said
        assert program.process.returncode == 0, program.said
        assert "Traceback" not in program.said, program.said


def network_of(field: Field, fusion: Program) -> Network:
    """What fusion wrote as it stopped; on a machine so busy that its last solution would have taken
    longer than a stop may, what comes of all that it took in."""
    if "would take longer than a stop may" not in fusion.said:
        return load_network(field.out)
    messages = []
    for key, payload in read_checkpoint(field.out / "checkpoint.bin"):
        topic = topics.topic_of(key)
        assert topic is not None
        messages.append((topics.node_of(key), cdr.decode(topic.type_name, payload)))
    return pushed(load_inputs(field.site, network=None), tuple(messages)).results().network


def check_network(network: Network, expected: Network, fusion: Program) -> None:
    """The drive's cameras are where they are without the fire, within a tenth of a sigma."""
    for name, record in expected.cameras.items():
        apart = apart_sigmas(network.cameras[name], record)
        assert np.abs(apart).max() < 0.1, (name, apart, fusion.said)
