"""Where the robots of a drawn session go, and how they stand before the cameras."""

from collections.abc import Callable

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import wrap
from trigpoint.site.target import Target

from .recipe import Recipe, Route
from .ride import Driver, Ride
from .room import Camera
from .views import faces_in_sight

_PICTURE_STAND_S, _SHORT_STAND_S = 1.0, 0.6
_MOST_DRAWS = 60
# No further place is gone to after that; a drive has pictures all the time.
_LONGEST_DANCE_S, _LONGEST_DRIVE_S = 300.0, 150.0


class _Tour(Struct, frozen=True, eq=False):
    """One robot's tour: the cameras from its first one on, and what it does before them."""

    recipe: Recipe
    random: np.random.Generator
    target: Target
    cameras: list[Camera]
    driver: Driver
    lift_after: frozenset[int]


def ride_of(
    recipe: Recipe, cameras: list[Camera], target: Target, number: int, *, lifts: int
) -> Ride:
    """The ride of a robot: `number` from 0 on; it begins before another camera each."""
    name = f"r{number + 1}"
    random = recipe.random("route", name)
    shift = number * len(cameras) // max(recipe.robots, 1)
    ordered = cameras[shift:] + cameras[:shift]
    start = np.append(random.uniform(-0.6, 0.6, 2), random.uniform(-np.pi, np.pi))
    # The map is the first robot's odometry frame; another robot's lies anywhere.
    odometry = start if number == 0 else np.append(random.uniform(-3, 3, 2), random.uniform(-3, 3))
    driver = Driver(recipe, name, start, odometry_start=odometry)
    driver.stand(0.5)
    places = np.arange(1, max(2, len(cameras)))
    chosen = random.choice(places, size=min(lifts, len(places)), replace=False)
    tour = _Tour(recipe, random, target, ordered, driver, frozenset(chosen.tolist()))
    _ROUTES[recipe.route](tour)
    driver.stand(0.5)
    return driver.ride()


def _loop(tour: _Tour) -> None:
    """Once before every camera, and to two of them again: 10 to 15 cm away, turned otherwise."""
    stood: dict[str, np.ndarray] = {}
    for index, camera in enumerate(tour.cameras):
        _maybe_lifted(tour, index)
        place = camera.stand + tour.random.normal(0, 0.12, 2)
        _stop(tour, camera, place, _PICTURE_STAND_S)
        stood[camera.name] = tour.driver.here
    for camera in _met_again(tour):
        before = stood[camera.name]
        angle = tour.random.uniform(0, 2 * np.pi)
        away = tour.random.uniform(0.10, 0.15) * np.array([np.cos(angle), np.sin(angle)])
        _stop(tour, camera, before[:2] + away, _PICTURE_STAND_S, unlike=before[2])


def _dance(tour: _Tour) -> None:
    """Several times before every camera, turned anew, and to two of them again."""
    for index, camera in enumerate(tour.cameras):
        _maybe_lifted(tour, index)
        if tour.driver.now_s > _LONGEST_DANCE_S:
            return
        _round(tour, camera, int(tour.random.integers(3, 8)))
    for camera in _met_again(tour):
        _round(tour, camera, 3)


def _round(tour: _Tour, camera: Camera, stops: int) -> None:
    for _ in range(stops):
        place = camera.stand + tour.random.normal(0, 0.22, 2)
        _stop(tour, camera, place, _SHORT_STAND_S)


def _drive(tour: _Tour) -> None:
    """To every camera, and to two of them again, turning before each."""
    for index, camera in enumerate([*tour.cameras, *_met_again(tour)]):
        _maybe_lifted(tour, index)
        if tour.driver.now_s > _LONGEST_DRIVE_S:
            return
        for _ in range(int(tour.random.integers(1, 4))):
            tour.driver.go_to(camera.stand + tour.random.normal(0, 0.25, 2))
            turn = tour.random.uniform(0.5, 4.0) * tour.random.choice([-1, 1])
            tour.driver.turn_by(float(turn))


def _free(tour: _Tour) -> None:
    """Along arcs to places before cameras and anywhere between them, without a stop."""
    stands = np.array([camera.stand for camera in tour.cameras])
    count = int(tour.random.integers(2 * len(stands), 4 * len(stands) + 4))
    for index in range(count):
        _maybe_lifted(tour, index)
        if tour.driver.now_s > _LONGEST_DRIVE_S:
            return
        near = stands[tour.random.integers(len(stands))]
        if tour.random.random() < 0.3:
            near = near * tour.random.uniform(0.1, 0.9)
        tour.driver.curve_to(near + tour.random.normal(0, 0.4, 2))


_ROUTES: dict[Route, Callable[[_Tour], None]] = {
    Route.LOOP: _loop,
    Route.DANCE: _dance,
    Route.DRIVE: _drive,
    Route.FREE: _free,
}


def _met_again(tour: _Tour) -> list[Camera]:
    """The first camera and one of the others."""
    if len(tour.cameras) == 1:
        return tour.cameras
    return [tour.cameras[0], tour.cameras[tour.random.integers(1, len(tour.cameras))]]


def _stop(
    tour: _Tour,
    camera: Camera,
    place: np.ndarray,
    seconds: float,
    *,
    unlike: float | None = None,
) -> None:
    """Drive to a place, turn so that the camera sees something, and stand."""
    seen_from = heading_in_sight(tour.recipe, tour.random, tour.target, camera, place, unlike)
    tour.driver.go_to(place)
    tour.driver.turn_to(seen_from[0])
    tour.driver.stand(seconds)


def heading_in_sight(
    recipe: Recipe,
    random: np.random.Generator,
    target: Target,
    camera: Camera,
    place: np.ndarray,
    unlike: float | None,
) -> tuple[float, bool]:
    """A drawn heading, by more than 50° unlike another one, and whether the camera finds a face at
    it; of many the first at which it does."""
    heading = 0.0
    for _ in range(_MOST_DRAWS):
        heading = float(random.uniform(-np.pi, np.pi))
        if unlike is not None and abs(wrap(heading - unlike)) < np.radians(50):
            continue
        if faces_in_sight(recipe, target, np.append(place, heading), camera):
            return heading, True
    return heading, False


def _maybe_lifted(tour: _Tour, index: int) -> None:
    """Put the robot elsewhere on the way to the camera of this number."""
    if index not in tour.lift_after:
        return
    other = tour.cameras[tour.random.integers(len(tour.cameras))]
    between = tour.random.uniform(0.3, 0.9) * other.stand + tour.random.normal(0, 0.3, 2)
    tour.driver.lift_to(np.append(between, tour.random.uniform(-np.pi, np.pi)))
