"""What results of a drive are held against: the truth, and their own covariance."""

import json
import math

from msgspec.structs import replace
from scipy.special import chdtri
from support.fusion.drives import Session

from trigpoint.contract.messages import Message
from trigpoint.fusion.estimators.results import Results
from trigpoint.geometry.uncertainty import is_positive_semidefinite
from trigpoint.map.network import encode_network

# One drive in a million is further off, either way, where the covariance is honest.
UNLIKELY = 1e-6

Messages = tuple[tuple[str, Message], ...]


def assert_honest(session: Session, results: Results, *, cameras: int = 3) -> None:
    """Every camera located, within 5 of its sigmas, and all together as their joint covariance
    says."""
    assert statuses(results) == dict.fromkeys(list(session.plan.cameras)[:cameras], "located")
    error = session.error(results)
    for name, camera in error.cameras.items():
        assert camera.sigmas < 5, name
    assert error.nees is not None
    freedom = 6 * len(error.cameras)
    low, high = chdtri(freedom, [1 - UNLIKELY, UNLIKELY]) / freedom
    assert low < error.nees < high
    assert_sound(results)


def assert_sound(results: Results) -> None:
    """Nothing in the network is not a number, and covariances are some."""
    assert_finite(json.loads(encode_network(results.network)))
    assert results.covariance.shape == (6 * len(results.network.located),) * 2
    if results.network.located:
        assert is_positive_semidefinite(results.covariance)


def assert_finite(value: object) -> None:
    """No number in nested lists and dictionaries is infinite or none."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            assert_finite(item)
    elif isinstance(value, float):
        assert math.isfinite(value)


def statuses(results: Results) -> dict[str, str]:
    """Camera -> located, undetermined or unseen."""
    return {name: camera.status for name, camera in results.network.cameras.items()}


def changed(session: Session, **messages: Messages) -> Session:
    """The session with other messages."""
    return replace(session, **messages)  # pyright: ignore[reportArgumentType]
