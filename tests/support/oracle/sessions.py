"""Drawn sessions so small that every explanation of them can be enumerated: one or two cameras, one
robot, one picture a stop, to about four views of two faces."""

from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from msgspec import Struct, field
from msgspec.structs import replace
from support.oracle.posterior import Oracle
from support.oracle.views import Look, Priors

from benchmarks.compositions.carried import target_of
from benchmarks.compositions.files import site_text
from benchmarks.compositions.recipe import Recipe
from benchmarks.compositions.ride import Driver
from benchmarks.compositions.room import Camera, cameras_of
from benchmarks.compositions.route import heading_in_sight
from benchmarks.compositions.session import Composition
from benchmarks.compositions.views import Carrier, Picture, pictures_of
from trigpoint.contract.messages import CameraInfo, Message, Odometry, Sightings
from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.graph import Graph
from trigpoint.fusion.association.modes import ModeFinder
from trigpoint.fusion.association.visits import visit_of
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.site.config import Site, parse_site
from trigpoint.site.target import Target


class Shape(Struct, frozen=True):
    """What a small session looks like. `stops`: the number (0 or 1) of the camera before which the
    robot stands at each of its views; `is_alike`: equal checkerboards or known faces; `displaced`:
    the views whose first sighting lies 15 px off; `lift`: the view before which the robot is put
    elsewhere; `move`: the view before which its camera is moved; `is_near`: met again 10 to 15 cm
    away, not anywhere before the camera."""

    seed: int
    stops: tuple[int, ...] = (0, 0)
    is_alike: bool = True
    displaced: tuple[int, ...] = ()
    lift: int | None = None
    move: int | None = None
    is_near: bool = False
    sigma_px: float = 0.25


class SmallSession(Struct, frozen=True, eq=False):
    """`messages`: (camera or robot, message) in the order of their stamps."""

    shape: Shape
    composition: Composition
    site: Site
    target: Target
    messages: list[tuple[str, Message]] = field(default_factory=list)

    @property
    def looks(self) -> list[Look]:
        """The pictures with a sighting, in order of time."""
        lenses = {
            node: message.camera
            for node, message in self.messages
            if isinstance(message, CameraInfo)
        }
        return [
            Look(node, lenses[node], message.stamp_ns, message.faces)
            for node, message in self.messages
            if isinstance(message, Sightings)
        ]

    @property
    def odometry(self) -> list[Odometry]:
        return [message for _, message in self.messages if isinstance(message, Odometry)]

    @property
    def is_lift_told(self) -> bool:
        """Whether a camera was met before and after the lift, if there was one."""
        if self.shape.lift is None:
            return True
        before, after = self.shape.stops[: self.shape.lift], self.shape.stops[self.shape.lift :]
        return bool(set(before) & set(after))

    def oracle(self, priors: Priors | None = None) -> Oracle:
        """The oracle of what was recorded."""
        noise = self.site.robots["r1"].odometry
        return Oracle(self.odometry, self.looks, self.target, noise, priors)


@st.composite
def shapes(draw: st.DrawFn, *, most_views: int = 4) -> Shape:
    """A strategy for the shapes: hundreds of different small sessions, the plainest first."""
    views = draw(st.integers(1, most_views))
    first = [0, *draw(st.lists(st.integers(0, 1), min_size=views - 1, max_size=views - 1))]
    numbers = st.integers(1, views - 1) if views > 1 else st.none()
    kind = draw(st.sampled_from(["plain", "plain", "displaced", "lift", "move"]))
    return Shape(
        seed=draw(st.integers(0, 10_000)),
        stops=tuple(first),
        is_alike=draw(st.booleans()),
        displaced=(draw(st.integers(0, views - 1)),) if kind == "displaced" else (),
        lift=draw(st.none() | numbers) if kind == "lift" else None,
        move=draw(st.none() | numbers) if kind == "move" else None,
        is_near=draw(st.booleans()),
        sigma_px=draw(st.sampled_from([0.25, 0.1, 0.5])),
    )


def drawn_shape(number: int, *, most_views: int = 4) -> Shape:
    """One of hundreds of drawn shapes, always the same, where no library is to choose."""
    random = np.random.default_rng([number, 7])
    views = int(random.integers(1, most_views + 1))
    kind = random.choice(["plain", "displaced", "lift", "move"], p=[0.4, 0.3, 0.15, 0.15])
    at = int(random.integers(1, views)) if views > 1 else None
    return Shape(
        seed=number,
        stops=(0, *random.integers(0, 2, views - 1).tolist()),
        is_alike=bool(random.random() < 0.6),
        displaced=(int(random.integers(0, views)),) if kind == "displaced" else (),
        lift=at if kind == "lift" else None,
        move=at if kind == "move" else None,
        is_near=bool(random.random() < 0.5),
        sigma_px=float(random.choice([0.1, 0.25, 0.5])),
    )


def small_session(shape: Shape) -> SmallSession:
    """The session of a shape, always the same."""
    pattern = "checkerboard" if shape.is_alike else "charuco"
    recipe = Recipe("small", shape.seed, cameras=6, pattern=pattern, sigma_px=shape.sigma_px)
    hung = cameras_of(recipe)[: max(shape.stops) + 1]
    target = target_of(pattern, recipe.shape)
    driver, stands_s = _driven(shape, recipe, hung, target)
    carrier = Carrier("r1", target, target, driver.ride())
    cameras = [_moved(shape, recipe, camera, stands_s) for camera in hung]
    pictures: dict[str, list[Picture]] = {camera.name: [] for camera in cameras}
    for view, (number, t_s) in enumerate(zip(shape.stops, stands_s, strict=True)):
        camera = cameras[number]
        for picture in pictures_of(recipe, camera, [carrier], np.array([t_s])):
            pictures[camera.name].append(
                _displaced(picture, recipe, view) if view in shape.displaced else picture
            )
    composition = Composition(recipe, cameras, [carrier], pictures, {"r1": []})
    site = parse_site(site_text(composition), directory=Path())
    messages = [(node, message) for _, node, message in composition.messages()]
    return SmallSession(shape, composition, site, target, messages)


def _driven(
    shape: Shape, recipe: Recipe, cameras: list[Camera], target: Target
) -> tuple[Driver, list[float]]:
    """The robot's drive, and when it stands for each view."""
    random = recipe.random("small route")
    start = np.append(random.uniform(-0.6, 0.6, 2), random.uniform(-np.pi, np.pi))
    driver, stands_s = Driver(recipe, "r1", start, odometry_start=start), []
    driver.stand(0.2)
    stood: dict[int, np.ndarray] = {}
    for view, number in enumerate(shape.stops):
        if view == shape.lift:
            away = random.normal(0, 1.0, 2) + 0.5 * cameras[number].stand
            driver.lift_to(np.append(away, random.uniform(-np.pi, np.pi)))
        camera = cameras[number]
        place = camera.stand + random.normal(0, 0.15, 2)
        if shape.is_near and number in stood:
            angle = random.uniform(0, 2 * np.pi)
            place = stood[number][:2] + random.uniform(0.10, 0.15) * np.array(
                [np.cos(angle), np.sin(angle)]
            )
        driver.go_to(place)
        before = stood[number][2] if number in stood else None
        heading, is_seen = heading_in_sight(recipe, random, target, camera, place, before)
        if not is_seen:
            raise ValueError("the camera sees nothing of the robot, however it turns")
        driver.turn_to(heading)
        stood[number] = driver.here
        driver.stand(0.4)
        stands_s.append(driver.ride().stops_s[-1])
    driver.stand(0.2)
    return driver, stands_s


def _moved(shape: Shape, recipe: Recipe, camera: Camera, stands_s: list[float]) -> Camera:
    if shape.move is None or camera.name != f"c{shape.stops[shape.move] + 1}":
        return camera
    return camera.knocked(stands_s[shape.move] - 0.5, recipe.random("small knock"))


def _displaced(picture: Picture, recipe: Recipe, view: int) -> Picture:
    """The picture with its first sighting 15 px off."""
    angle = recipe.random("small displacement", view).uniform(0, 2 * np.pi)
    first, *others = picture.faces
    by = 15.0 * np.array([np.cos(angle), np.sin(angle)])
    pixels = (first.sighting.pixels + by).astype(np.float32)
    sighting, is_good = replace(first.sighting, pixels=pixels), np.zeros(len(pixels), dtype=bool)
    wrong = replace(first, sighting=sighting, is_good=is_good)
    return replace(picture, faces=(wrong, *others))


def data_of(shape: Shape) -> tuple[DataSet, list[Observation]]:
    """What fusion knows of such a session once all of it came in, before it is explained."""
    session = small_session(shape)
    pipeline = Pipeline(Inputs(session.site, {"r1": session.target}), is_live=False)
    replayed(pipeline, session.messages).finish()
    data = pipeline._data  # pyright: ignore[reportPrivateUsage]
    return data, [entry.observation for entry in data.entries]


def graph_of(shape: Shape) -> Graph:
    """A graph in which every picture is a visit of its own."""
    data, observations = data_of(shape)
    finder = ModeFinder(data, observations, Events())
    visits = [finder.modes_of(visit_of(observations, [i])) for i in range(len(observations))]
    return Graph(data, visits, Events())
