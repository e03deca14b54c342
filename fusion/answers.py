"""What fusion answers to commands; on the bus's threads."""

import json
import threading
from collections.abc import Callable
from uuid import UUID

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import OperationError

from .estimators.results import Results
from .fair_lock import FairLock
from .pipeline import Pipeline

ANSWER_S = 2.0
"""How long a command waits for what it asks for."""
_LOOK_S = 0.01


def solved(
    now: Callable[[], Pipeline], lock: FairLock, clock: Clock, stopping: threading.Event
) -> Results:
    """The results of the pipeline of now, as it knows them; raise OperationError where there are
    none yet. A solver answers once its current work is done; until then the last answer holds."""
    with lock:
        pipeline = now()
        pipeline.reports.ask()
    until_ns = clock.elapsed_ns() + to_ns(ANSWER_S)
    while not pipeline.reports.is_answered and clock.elapsed_ns() < until_ns:
        if stopping.wait(_LOOK_S):
            break
    with lock:
        return pipeline.results()


def map_answer(map_id: UUID | None) -> bytes:
    """The map's UUID; raise OperationError where there is no map."""
    if map_id is None:
        raise OperationError("there is no map yet: no odometry of the first robot has come")
    return json.dumps({"map_id": str(map_id)}).encode()
