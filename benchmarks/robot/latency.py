"""From exposure to correction through the whole site, beside the sum of its parts measured alone.

    python -m benchmarks latency [--seconds 90]

The lab's programs run as they do in a site: three simulated cameras' agent, fusion, the bridge and
the robot; a correction has come when the robot has taken it over. All the time beside it each part
runs alone, so that it waits for cores as the whole does: an agent of another site (exposure,
picture, detection, bus), the filter over the same drive (taking in and computing), and a bridge
with its robot, which is corrected from here (bus, judging, line).
"""

import json
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated
from uuid import UUID

import numpy as np
import typer

from benchmarks.machine import machine
from trigpoint.base.clock import to_ns
from trigpoint.bus.bus import Bus, Subscription
from trigpoint.contract import topics
from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import CameraInfo, Message, Odometry, PoseEstimate, Sightings
from trigpoint.fusion.inputs import load_inputs
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.site.config import load_site
from trigpoint.tools.parts.specs import agent, bridge, firmware, trigpoint
from trigpoint.tools.simulation.site_files import robot_port, write_site
from trigpoint.tools.simulation.world import World, load_world
from trigpoint.zenoh import open_bus

CAMERAS = ("c1", "c2", "c3")
_HEARD = (topics.CAMERA_INFO, topics.ODOMETRY, topics.SIGHTINGS, topics.CORRECTION)
_START_S = 15.0
# From exposure to the sightings on the bus, about.
_DETECTED_NS = to_ns(0.07)
_CORRECT_EVERY_S = 0.1


@dataclass(slots=True)
class Heard:
    """Messages in the order in which they came, with the node that sent each; how late each
    correction came after the exposure, and each sighting of a picture with a face, milliseconds."""

    messages: list[tuple[int, str, Message]] = field(default_factory=list)
    sightings_ms: list[float] = field(default_factory=list)
    corrections_ms: list[float] = field(default_factory=list)

    def take(self, subscriptions: Mapping[topics.Topic, Subscription]) -> None:
        for topic, subscription in subscriptions.items():
            while (sample := subscription.take(0.0)) is not None:
                message = decode(topic.type_name, sample.payload)
                node = topics.node_of(sample.key)
                if isinstance(message, PoseEstimate):
                    self.corrections_ms.append((sample.received_ns - message.stamp_ns) / 1e6)
                    continue
                self.messages.append((sample.received_ns, node, message))
                if isinstance(message, Sightings) and message.faces:
                    self.sightings_ms.append((sample.received_ns - message.stamp_ns) / 1e6)


class Lab:
    """A site in a folder whose programs are started by name."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name
        world = load_world("lab", seed=1)
        world.site_name = name  # sites of other names never meet
        for name in [name for name in world.cameras if name not in CAMERAS]:
            del world.cameras[name]
        self.epoch_ns = time.time_ns() + to_ns(_START_S)
        self.site = write_site(world, folder, epoch_ns=self.epoch_ns)
        self.journal = folder / "r1.jsonl"

    def command(self, program: str) -> tuple[str, ...]:
        site, out = str(self.site), str(self.folder / "out")
        of_world = {"world": "lab", "seed": 1, "log": self.journal}
        link = self.folder / robot_port("r1")
        return {
            "firmware": firmware("r1", epoch_ns=self.epoch_ns, link=link, **of_world).command,
            "edge": agent(CAMERAS, site).command,
            "fusion": trigpoint("fusion", "--site", site, "--out", out),
            "robot": bridge("r1", site).command,
        }[program]

    def run(self, programs: tuple[str, ...], seconds: float) -> Heard:
        """Run these until so long after the robot drove off; what was heard."""
        heard = Heard()
        with ExitStack() as stack:
            bus = stack.enter_context(open_bus(load_site(self.site)))
            subscriptions = {t: bus.subscribe(t, t.expression(self.name)) for t in _HEARD}
            for program in programs:
                with (self.folder / f"{program}.log").open("ab") as log:
                    process = subprocess.Popen(self.command(program), stdout=log, stderr=log)
                stack.callback(process.wait, 20)
                stack.callback(process.terminate)
            end_ns = self.epoch_ns + to_ns(seconds)
            while time.time_ns() < end_ns:
                time.sleep(0.2)
                heard.take(subscriptions)
        heard.messages.sort(key=lambda row: row[0])
        return heard

    @property
    def taken(self) -> list[dict]:
        """The corrections that the robot took over, by its own journal."""
        notes = [json.loads(line) for line in self.journal.read_text().splitlines()]
        return [note for note in notes if note["kind"] == "correction"]


def whole_ms(folder: Path, seconds: float) -> tuple[list[float], Heard]:
    """The whole site: how late the robot took over each correction, and what was heard."""
    lab = Lab(folder, "lab")
    heard = lab.run(("firmware", "fusion", "edge", "robot"), seconds)
    return [(note["at_ns"] - note["stamp_ns"]) / 1e6 for note in lab.taken], heard


def agent_ms(folder: Path, seconds: float) -> list[float]:
    """How late an agent's sightings are on the bus, where there is nothing else."""
    return Lab(folder, "alone").run(("edge",), seconds).sightings_ms


def bridged_ms(folder: Path, seconds: float) -> list[float]:
    """How long corrections take from the bus to a robot whose bridge has nothing else beside it."""
    lab, stopping, put_ns = Lab(folder, "bridge"), threading.Event(), dict[int, int]()
    with open_bus(load_site(lab.site)) as bus:
        thread = threading.Thread(target=_correct, args=(bus, lab.name, stopping, put_ns))
        thread.start()
        try:
            lab.run(("firmware", "robot"), seconds)
        finally:
            stopping.set()
            thread.join()
    return [(note["at_ns"] - put_ns[note["sequence"]]) / 1e6 for note in lab.taken]


def _correct(bus: Bus, site: str, stopping: threading.Event, put_ns: dict[int, int]) -> None:
    """Tell the robot where its odometry has it, ten times a second; `put_ns`: when, by number."""
    map_id, pose_sigma2 = UUID(int=7), np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4])
    bus.serve(topics.command_key(site, "fusion/map"), lambda _: _map_answer(map_id))
    corrections = bus.publisher(topics.CORRECTION, topics.CORRECTION.key(site, "r1"))
    odometry = bus.subscribe(topics.ODOMETRY, topics.ODOMETRY.key(site, "r1"))
    number = 0
    while not stopping.wait(_CORRECT_EVERY_S):
        payloads = []
        while (sample := odometry.take(0.0)) is not None:
            payloads.append(sample.payload)
        if len(payloads) < 2:
            continue
        at, number = decode(topics.ODOMETRY.type_name, payloads[-2]), number + 1
        assert isinstance(at, Odometry)
        estimate = PoseEstimate(at.stamp_ns, "map", at.pose, pose_sigma2)
        put_ns[number] = time.time_ns()
        corrections.put(encode(estimate), attachment=encode_mark(CorrectionMark(map_id, number)))


def _map_answer(map_id: UUID) -> bytes:
    return json.dumps({"map_id": str(map_id)}).encode()


def filtered_ms(folder: Path, seconds: float) -> list[float]:
    """How long the filter takes for what leads to a correction, at the drive's pace."""
    lab = Lab(folder, "filter")
    inputs = load_inputs(load_site(lab.site), network=None)
    solver = SolverProcess(inputs.data_set())
    try:
        pipeline = Pipeline(inputs, is_live=False, solver=solver)
        pipeline.resumed(is_new=True)
        messages = drive(load_world("lab", seed=1), to_ns(seconds))
        return _filtered(pipeline, messages, lab.epoch_ns)
    finally:
        solver.close()


def _filtered(
    pipeline: Pipeline, messages: list[tuple[int, str, Message]], epoch_ns: int
) -> list[float]:
    took_ms, spent_s = list[float](), 0.0
    for at_ns, node, message in messages:
        time.sleep(max(0, epoch_ns + at_ns - time.time_ns()) / 1e9)
        begin_s = time.perf_counter()
        pipeline.push(node, message)
        outputs = pipeline.advance(at_ns)
        spent_s += time.perf_counter() - begin_s
        if any(output.topic is topics.CORRECTION for output in outputs):
            took_ms.append(1e3 * spent_s)
        if outputs or isinstance(message, Odometry):
            spent_s = 0.0
    return took_ms


def drive(world: World, until_ns: int) -> list[tuple[int, str, Message]]:
    """(nanoseconds of the drive, node, message): what cameras and robot tell, as sightings are
    drawn."""
    rows: list[tuple[int, str, Message]] = []
    for name in CAMERAS:
        eye = world.cameras[name]
        frame, size = f"{name}/optical", (eye.model.width, eye.model.height)
        rows.append((0, name, CameraInfo(0, frame, eye.model)))
        for t_s in eye.time_of(np.arange(int(world.duration_s * eye.rate) - 1)):
            faces, stamp_ns = world.sightings(name, float(t_s)), to_ns(float(t_s))
            told = Sightings(stamp_ns, frame, *size, faces)
            rows.append((stamp_ns + _DETECTED_NS, name, told))
    log = world.odometry("r1")
    for number, t_s in enumerate(log.stamps_s):
        stamp_ns = to_ns(float(t_s))
        odometry = Odometry(stamp_ns, "r1/odom", "r1/base", log.poses[number])
        rows.append((stamp_ns, "r1", odometry))
    return sorted((row for row in rows if row[0] < until_ns), key=lambda row: row[0])


def main(seconds: Annotated[float, typer.Option(help="Of the drive.")] = 90.0) -> None:
    """From exposure to correction through the whole site, beside the sum of its parts."""
    before = machine()
    with (
        tempfile.TemporaryDirectory() as name,
        ProcessPoolExecutor(4, mp_context=get_context("spawn")) as pool,
    ):
        folder = Path(name)
        running = pool.submit(whole_ms, folder / "whole", seconds)
        agent = pool.submit(agent_ms, folder / "agent", seconds)
        filtered = pool.submit(filtered_ms, folder / "filter", seconds)
        bridged = pool.submit(bridged_ms, folder / "bridge", seconds)
        parts = {
            "agent": agent.result(),
            "filter": filtered.result(),
            "bridge": bridged.result(),
        }
        whole, heard = running.result()
    if not (whole and heard.corrections_ms and all(parts.values())):
        raise SystemExit(
            f"no correction in {seconds:.0f} s; say more --seconds, or free the machine"
        )
    _tell(parts, whole, heard)
    print(f"{before.summary}; {machine().load:.1f} at the end")


def _tell(parts: dict[str, list[float]], whole: list[float], heard: Heard) -> None:
    marks = {name: np.percentile(values, [50, 95]) for name, values in parts.items()}
    for name, (half, most) in marks.items():
        print(f"{name} alone: p50 {half:.1f}, p95 {most:.1f} ms ({len(parts[name])})")
    for what, values in (("sightings", heard.sightings_ms), ("corrections", heard.corrections_ms)):
        half, most = np.percentile(values, [50, 95])
        print(f"in the whole, exposure to {what} on the bus: p50 {half:.1f}, p95 {most:.1f} ms")
    half, most = np.percentile(whole, [50, 95])
    ratio = most / sum(mark[1] for mark in marks.values())
    print(f"exposure to correction at the robot: p50 {half:.1f}, p95 {most:.1f} ms ({len(whole)})")
    print(f"p95 over the sum of the parts' p95: {ratio:.2f}")
