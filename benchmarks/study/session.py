"""One simulated session of a situation: what the estimator gets, and what an oracle knows."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
from msgspec import Struct, structs
from msgspec.structs import replace

from trigpoint.contract.messages import Message, Odometry, Sightings
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.site.config import Site, parse_site
from trigpoint.tools.networks.cramer_rao import Bound
from trigpoint.tools.simulation.world import World

from .decidable import left_open
from .in_memory import Simulated, simulated
from .oracle import bound_of, known_to_oracle
from .situations import NEW_CAMERA, SITUATIONS, Known, Situation
from .worlds import world_of

# 0.1 mm and 0.1 mrad, as for a network that is read from a file.
_FLOOR = 1e-8
_PLAIN = Situation("a plain session")


class StudySession(Struct, frozen=True, eq=False):
    """`messages`: (camera or robot, message) in the order in which they are pushed."""

    name: str
    seed: int
    inputs: Inputs
    messages: list[tuple[str, Message]]
    simulated: Simulated

    @property
    def bound(self) -> Bound:
        """The Cramér-Rao bound of the cameras' poses; a camera that was moved also stands in it as
        it hung before."""
        return bound_of(self.inputs, self.simulated)

    @property
    def left_open(self) -> set[str]:
        """The cameras whose place the data leave open."""
        data, oracle = known_to_oracle(self.inputs, self.simulated)
        return left_open(data, oracle)


def simulated_session(name: str, seed: int, *, estimator: str = "smoother") -> StudySession:
    """A session of a situation of the table; the same for the same seed."""
    situation = SITUATIONS[name]
    world = world_of(situation.world, seed=seed, target=situation.target)
    for robot, item in world.robots.items():
        noise = structs.replace(item.noise, **situation.odometry)
        world.robots[robot] = replace(item, noise=noise)
    session = simulated(world, situation.disturbance)
    inputs, messages = inputs_of(world, situation, estimator), session.messages
    if situation.is_in_order:
        messages = sorted(messages, key=_stamp)
    return StudySession(name, seed, inputs, messages, session)


def inputs_of(world: World, situation: Situation = _PLAIN, estimator: str = "smoother") -> Inputs:
    """What an estimator is told of a world, in a plain situation by a site file without anything to
    be estimated."""
    site = _site(world, situation, estimator)
    lenses = {name: camera.model for name, camera in world.cameras.items()}
    if situation.is_lens_nominal:
        lenses = {name: camera.nominal() for name, camera in site.cameras.items()}
    targets = {robot: world.target(robot) for robot in world.robots}
    return Inputs(site, targets, lenses, _known(world, situation))


def worked_out(session: StudySession) -> Pipeline:
    """A pipeline after the whole session, as `calibrate` does it."""
    return fed(session.inputs, session.messages)


def fed(inputs: Inputs, messages: Iterable[tuple[str, Message]]) -> Pipeline:
    """A pipeline after all these messages, finished."""
    pipeline = replayed(Pipeline(inputs, is_live=False), messages)
    pipeline.finish()
    return pipeline


def _stamp(item: tuple[str, Message]) -> tuple[int, bool]:
    message = item[1]
    assert isinstance(message, (Odometry, Sightings))
    return message.stamp_ns, isinstance(message, Sightings)


def _site(world: World, situation: Situation, estimator: str) -> Site:
    def camera(name: str) -> dict[str, object]:
        lens = world.cameras[name].model
        size = {"width": lens.width, "height": lens.height}
        return {"source": f"sim://{name}", **size, **situation.camera}

    settings = {
        "cameras": {name: camera(name) for name in world.cameras},
        "robots": {
            name: {"port": "loop://", "odometry": structs.asdict(robot.noise)}
            for name, robot in world.robots.items()
        },
        "fusion": {
            "estimator": estimator,
            # What is true of the simulated floor and mast is said.
            "priors": {"floor_tilt": 0.0, "target_sway": 0.0},
            **situation.fusion,
        },
    }
    text = 'site = "study"\ntarget = "target.toml"\n'
    return parse_site(text, directory=Path(), settings=settings)


def _known(world: World, situation: Situation) -> KnownCameras:
    """Cameras of an earlier network: the truth as it was then, and errors by its covariance."""
    if situation.known is Known.NONE:
        return KnownCameras.none()
    bound = _earlier_bound()
    random = world.random("earlier network", world.site_name)
    root = np.linalg.cholesky(bound.covariance + _FLOOR * np.eye(len(bound.covariance)))
    error = (root @ random.standard_normal(len(root))).reshape(-1, 6)
    poses = {
        name: world.cameras[name].map_from_camera.disturbed(error[index])
        for index, name in enumerate(bound.cameras)
    }
    if situation.known is Known.ALL_BUT_ONE:
        del poses[NEW_CAMERA]
    kept = bound.of(list(poses)).covariance
    return KnownCameras(poses, np.linalg.inv(kept + _FLOOR * np.eye(len(kept))))


@cache
def _earlier_bound() -> Bound:
    """That of an undisturbed drive."""
    return simulated_session("drive", 0).bound
