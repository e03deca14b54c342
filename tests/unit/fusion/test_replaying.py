"""A replay works where there is something to do, with what comes of work at every message."""

from itertools import groupby

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    Session,
    lab_cameras,
    lab_plan,
    make_session,
    two_robots,
)
from support.fusion.solvers import Listed

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.fusion.inbox import Input
from trigpoint.fusion.live.solver_messages import (
    Order,
    TakeObservation,
    TakeOdometry,
)
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.replaying import Replay, replayed

MORE = "time_offset_sigma = 0.05\nline_delay = 3e-5"


@pytest.fixture(scope="module")
def one() -> Session:
    """One robot before rolling shutters with clocks to be estimated."""
    return make_session(lab_plan(cameras=lab_cameras(3, more=MORE), seconds=12.0))


@pytest.fixture(scope="module")
def two() -> Session:
    """Two robots that are told apart at the end."""
    return make_session(
        lab_plan(cameras=lab_cameras(3, more=MORE), robots=two_robots(), seconds=12.0)
    )


def told(
    session: Session, messages: list[tuple[str, Input]], *, always: bool
) -> tuple[list[Order], dict[str, int]]:
    """What a solver is told of messages, and what was left out; `always`: at work each time."""
    solver = Listed()
    pipeline = Pipeline(session.inputs, is_live=False, solver=solver)
    if always:
        for node, message in messages:
            pipeline.push(node, message)
            if isinstance(message, Odometry):
                pipeline.advance()
    else:
        replayed(pipeline, messages)
    pipeline.resumed()
    return solver.orders, pipeline.left_out


def flat(orders: list[Order]) -> list[object]:
    """Each observation, behind the odometry that the solver has by then of each robot."""
    found, seen = list[object](), dict[str, list[bytes]]()
    for order in orders:
        if isinstance(order, TakeOdometry):
            stamps_ns, poses = order.readings.stamps_ns, order.readings.odom_from_base
            assert len(poses) == len(stamps_ns)
            seen.setdefault(order.robot, []).extend(
                stamp_ns.tobytes() + poses[row].rows().tobytes()
                for row, stamp_ns in enumerate(stamps_ns)
            )
        elif isinstance(order, TakeObservation):
            observation = order.observation
            sweeps = [view.sweep for view in observation.views]
            twists = [each.twist.tobytes() for each in sweeps if each is not None]
            assert len(twists) == len(observation.views)
            here = observation.camera, observation.robot, observation.stamp_ns, twists
            found.append((here, {robot: b"".join(each) for robot, each in seen.items()}))
        else:
            found.append(type(order))
    return found


def shuffled(session: Session) -> list[tuple[str, Input]]:
    """Some sightings come late, and one camera's a minute ahead of their time."""
    random = np.random.default_rng(4)

    def arrives_ns(message: Input) -> float:
        is_late = isinstance(message, Sightings) and random.random() < 0.3
        return message.stamp_ns + is_late * random.uniform(0, 1e9)

    messages = sorted(session.messages, key=lambda item: arrives_ns(item[1]))
    return [
        (node, replace(message, stamp_ns=message.stamp_ns + to_ns(60.0)))
        if node == "c3" and isinstance(message, Sightings)
        else (node, message)
        for node, message in messages
    ]


@pytest.mark.parametrize("name", ["one", "two"])
def test_solver_is_told_the_same(name: str, request: pytest.FixtureRequest) -> None:
    session = request.getfixturevalue(name)
    messages = shuffled(session)
    (orders, left_out), (others, others_left_out) = (
        told(session, messages, always=always) for always in (False, True)
    )
    assert flat(orders) == flat(others)
    assert left_out == others_left_out
    assert sum(isinstance(order, TakeObservation) for order in orders) > 20


@pytest.mark.parametrize("name", ["one", "two"])
def test_odometry_by_runs_tells_the_solver_the_same(
    name: str, request: pytest.FixtureRequest
) -> None:
    """As a checkpoint gives it, here of a robot whose odometry comes half a second at once."""
    session, solver = request.getfixturevalue(name), Listed()
    messages = sorted(shuffled(session), key=lambda item: comes_s(*item))
    pipeline = Pipeline(session.inputs, is_live=False, solver=solver)
    replay, runs = Replay(pipeline), 0
    for (node, kind), run in groupby(messages, lambda item: (item[0], type(item[1]))):
        came = [message for _, message in run]
        readings = [Readings.of([m]) for m in came if isinstance(m, Odometry)]
        runs += len(readings) > 1
        for message in [Readings.joined(readings)] if kind is Odometry else came:
            replay.take(node, message)
    pipeline.resumed()
    orders, left_out = told(session, messages, always=True)
    assert flat(solver.orders) == flat(orders)
    assert pipeline.left_out == left_out
    assert runs > 20


def comes_s(node: str, message: Input) -> tuple[float, str]:
    """When a message comes, in half seconds, and in which order then."""
    return message.stamp_ns // to_ns(0.5), node


def test_odometry_is_told_in_fewer_orders_than_there_are_messages(two: Session) -> None:
    messages = list(two.messages)
    orders, _ = told(two, messages, always=False)
    count = sum(isinstance(message, Odometry) for _, message in messages)
    runs = [order for order in orders if isinstance(order, TakeOdometry)]
    assert sum(len(order.readings) for order in runs) == count
    assert len(runs) < count / 2
