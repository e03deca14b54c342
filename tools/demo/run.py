"""A run from its first process to its last: one a part of the system, as a user would start it."""

import os
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import msgspec
from msgspec import Struct

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.base.errors import OperationError
from trigpoint.bus.bus import Bus
from trigpoint.contract.topics import alive_key
from trigpoint.site.config import BusConfig, FusionConfig, RecorderConfig, Site
from trigpoint.tools.parts.output import LogFile
from trigpoint.tools.parts.specs import (
    AGENTS,
    BRIDGES,
    FIRMWARE,
    FUSION,
    PAGE,
    RECORDER,
    firmware,
    nodes,
    trigpoint,
)
from trigpoint.tools.parts.supervisor import PartSpec, Supervisor
from trigpoint.tools.simulation.world import World
from trigpoint.zenoh import open_bus

from .folder import DemoFolder, DemoRecord
from .progress import Progress, status_line
from .watch import Watch

_LEADS_S = (6.0, 20.0, 60.0)
"""From the first process to the world's start on an idle machine; the next where it is too slow."""

_LOOK_S = 0.1
_SETTLE_S = 3.0
_FLIGHT_S = 0.3
_MEETING_POINT = "tcp/127.0.0.1:0"
_AGENT_PROCESSES = 2


class NotUpInTimeError(OperationError):
    """The robot moved before everybody was there to see it."""


class Run(Struct, frozen=True):
    world: World
    folder: DemoFolder
    seconds: float
    progress: Progress
    has_viewer: bool = False
    protocol: str = "trigpoint"

    def carry_out(self) -> DemoRecord:
        """Run it to its end; raise OperationError where a part does not stay alive.

        However it ends, every process is stopped, the recording and the network are complete up to
        there, and what was counted is in the folder.
        """
        with open_bus(_meeting_site(self.world.site_name)) as bus:
            for lead_s in leads_s(os.getloadavg()[0], os.cpu_count() or 1):
                try:
                    return self._attempt(bus, lead_s)
                except NotUpInTimeError as reason:
                    self.progress.say(f"{reason}; once more with more time")
        raise OperationError(
            f"the parts of the demo were not up in time three times; see {self.folder.log}"
        )

    def _attempt(self, bus: Bus, lead_s: float) -> DemoRecord:
        self.folder.claim()
        record = self._record(lead_s)
        self.folder.prepare(self.world, record, bus.locators[0])
        specs = parts_of(self.world, self.folder, record)
        if self.has_viewer:
            specs.append(viewer_of(self.folder))
        watch = Watch(bus, self.world.site_name)
        with closing(watch):
            supervisor = Supervisor(specs, self._log, say=self.progress.say)
            try:
                with supervisor:
                    record = self._keep(record, supervisor, watch)
                    self._bring_up(record, supervisor, watch)
                    self._drive(record, supervisor, watch)
                    self.progress.close()
                    self._wind_down(supervisor, watch)
            finally:
                self.progress.close()
                watch.read()
                record = self._keep(record, supervisor, watch)
        return record

    def _log(self, part: str) -> LogFile:
        return LogFile.of(part, self.folder.log)

    def _record(self, lead_s: float) -> DemoRecord:
        world = self.world
        return DemoRecord(
            world=world.name,
            seed=world.seed,
            target=world.target_choice or "charuco",
            seconds=self.seconds,
            epoch_ns=time.time_ns() + to_ns(lead_s),
            protocol=self.protocol,
        )

    def _keep(self, record: DemoRecord, supervisor: Supervisor, watch: Watch) -> DemoRecord:
        """Write down who runs, what was started again, and what everybody counted."""
        kept = msgspec.structs.replace(
            record,
            processes={"demo": os.getpid(), **supervisor.processes},
            restarts=supervisor.restarts,
            counts=watch.counts(),
        )
        self.folder.write(kept)
        return kept

    def _bring_up(self, record: DemoRecord, supervisor: Supervisor, watch: Watch) -> None:
        """Return when everybody is at work; raise NotUpInTimeError where the robot moves first."""
        moves_s = min(robot.drive.start_s for robot in self.world.robots.values())
        while missing := self._not_yet_up(watch):
            if world_time(record) > moves_s:
                raise NotUpInTimeError(f"{', '.join(sorted(missing))} came up too late")
            supervisor.expect_all()
            time.sleep(_LOOK_S)
        self.progress.say(f"  {len(supervisor.parts)} processes are up; the robot drives off soon")

    def _not_yet_up(self, watch: Watch) -> set[str]:
        """Who is not alive, or a camera whose agent has had no picture, or a robot unheard."""
        missing = {token.partition("/alive/")[2] for token in watch.missing(tokens_of(self.world))}
        watch.read()
        counts = watch.counts()
        cameras = {f"edge/{camera}" for camera in self.world.cameras}
        robots = {f"robot/{robot}" for robot in self.world.robots}
        missing |= {node for node in cameras if not counts.get(node, {}).get("pictures")}
        return missing | {node for node in robots if not counts.get(node, {}).get("odometry")}

    def _drive(self, record: DemoRecord, supervisor: Supervisor, watch: Watch) -> None:
        while (now_s := world_time(record)) < self.seconds:
            watch.read()
            if supervisor.revive():
                self._keep(record, supervisor, watch)
            self.progress.show(now_s, status_line(watch, now_s, len(self.world.cameras)))
            time.sleep(_LOOK_S)

    def _wind_down(self, supervisor: Supervisor, watch: Watch) -> None:
        """Stop in an order in which nothing is lost."""
        for rank, kind in ((AGENTS, "edge"), (BRIDGES, "robot")):
            supervisor.stop([rank])
            self._settle(watch, kind)
        for rank in (FIRMWARE, RECORDER, FUSION):
            supervisor.stop([rank])

    def _settle(self, watch: Watch, kind: str) -> None:
        """Wait until what the stopped nodes of a kind sent was received, and what fusion makes of
        it has had time to follow."""
        deadline_s = time.monotonic() + _SETTLE_S
        watch.read()
        while not watch.is_settled(kind) and time.monotonic() < deadline_s:
            time.sleep(_LOOK_S)
            watch.read()
        watch.wait_for_fusion()
        time.sleep(_FLIGHT_S)


def leads_s(load: float, cores: int) -> tuple[float, ...]:
    """The leads where so many programs (`load`) want this machine's cores: to begin again costs
    more than to wait at first, and so does a start that shares its cores."""
    shared = max(1.0, load / cores)
    return tuple(min(lead_s * shared, _LEADS_S[-1]) for lead_s in _LEADS_S)


def world_time(record: DemoRecord) -> float:
    """Seconds since the world's start."""
    return (time.time_ns() - record.epoch_ns) / NANOSECONDS


def has_display() -> bool:
    names: Sequence[str] = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform == "darwin" or any(os.environ.get(name) for name in names)


def _meeting_site(name: str) -> Site:
    """The demo's own end of the bus: it listens on a port of this machine that the system picks,
    and every part is told of it."""
    bus = BusConfig(listen=(_MEETING_POINT,))
    return Site(
        name=name,
        cameras={},
        robots={},
        bus=bus,
        fusion=FusionConfig(),
        recorder=RecorderConfig(),
        directory=Path(),
        text="",
    )


def parts_of(world: World, folder: DemoFolder, record: DemoRecord) -> list[PartSpec]:
    """All parts. The slow ones to start come first."""
    here = DemoFolder(folder.path.resolve())
    specs = nodes(
        str(here.site),
        cameras=list(world.cameras),
        robots=list(world.robots),
        agents=_AGENT_PROCESSES,
        out=str(here.path),
    )
    for robot in world.robots:
        world_of = {"world": record.world, "seed": record.seed, "target": record.target}
        said = {"log": here.journal(robot), "protocol": record.protocol, **world_of}
        specs.append(firmware(robot, epoch_ns=record.epoch_ns, link=here.port(robot), **said))
    return specs


def viewer_of(folder: DemoFolder) -> PartSpec:
    """The live view in a window; it goes when the user closes it."""
    site = str(folder.site.resolve())
    return PartSpec("viewer", trigpoint("view", "--site", site), PAGE, needed=False)


def tokens_of(world: World) -> set[str]:
    alive = [("recorder", "main"), ("fusion", "fusion")]
    alive += [("edge", camera) for camera in world.cameras]
    alive += [("robot", robot) for robot in world.robots]
    return {alive_key(world.site_name, kind, name) for kind, name in alive}
