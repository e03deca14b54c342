"""The estimator over a recorded session or anybody's bag; prints nothing."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from msgspec import Struct

from trigpoint.base.errors import InputError, OperationError
from trigpoint.contract.messages import Message
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.inputs import load_inputs
from trigpoint.fusion.model.inputs import Inputs
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.recorder.session.recording import Recording, open_recording
from trigpoint.site.config import load_site
from trigpoint.site.option import site_here
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.sessions.messages import SessionMessages, messages_of


class Task(Struct, frozen=True):
    """What is to be worked out: the session at `path`, or anybody's bag (`recording` None) with the
    `topics` «camera or robot=topic» of it, and the inputs beside its messages."""

    path: Path
    recording: Recording | None
    topics: tuple[str, ...]
    inputs: Inputs

    def messages(self) -> SessionMessages:
        """Read all of it; a bag's pictures are searched for the target."""
        if self.recording is not None:
            return messages_of(self.recording)
        # OpenCV and bags are not needed by sessions.
        from trigpoint.tools.sessions.bag import bag_messages, parse_roles

        return bag_messages(self.path, parse_roles(self.topics), self.inputs)


def task_of(
    session: Path,
    *,
    site: Path | None = None,
    network: Path | None = None,
    topics: Sequence[str] = (),
    settings: Mapping[str, object] | None = None,
) -> Task:
    """Open a session, or with `topics` a bag. `site`: the site file, None: the attached one, for a
    bag that of this folder; `network`: whose cameras are known; `settings`: as `load_site` takes
    them. Raises InputError."""
    if topics:
        site = site or site_here()
        if site is None:
            raise InputError("--topic: a bag has no site file; give it with --site")
        inputs = load_inputs(load_site(site, settings), network=network)
        _check_learns(inputs)
        return Task(session, None, tuple(topics), inputs)
    recording = open_recording(session)
    recording.check_is_session()
    inputs = session_inputs(recording, site=site, network=network, settings=settings)
    _check_learns(inputs)
    return Task(session, recording, (), inputs)


def _check_learns(inputs: Inputs) -> None:
    """Refuse a site whose network is fixed: what is worked out of a session is one that was
    learnt."""
    if not inputs.site.fusion.learn:
        raise InputError(
            "[fusion] learn = false: the site's network is fixed, and calibrate works one out; "
            "give --site with a site file that says learn = true (and --network, for cameras that "
            "are known)"
        )


def calibrated(recording: Recording, inputs: Inputs) -> Results:
    """The results of a whole session; raise InputError if nothing in it can be used."""
    return worked_out(recording, inputs).results()


def worked_out(recording: Recording, inputs: Inputs) -> Pipeline:
    """A pipeline after a whole session; raise InputError if nothing in it can be used."""
    pipeline = fed(messages_of(recording), inputs, source=recording.path)
    pipeline.finish()
    return pipeline


def fed(
    found: SessionMessages,
    inputs: Inputs,
    *,
    source: Path,
    step: Callable[[int], None] = lambda _: None,
) -> Pipeline:
    """A pipeline that took these messages and is to be finished; `step`: told how many. Raises
    OperationError where no odometry is sound, InputError where there is none of the site's."""
    pipeline, robots = Pipeline(inputs, is_live=False), found.robots
    unreadable = found.unreadable
    for node in unreadable.keys() & inputs.site.cameras.keys():
        pipeline.arrivals.unreadable[node] = unreadable.pop(node)
    pipeline.arrivals.misdescribed |= found.misdescribed
    pipeline.arrivals.clocks |= found.clocks.apart(inputs.site)
    if not robots and (unsound := unreadable.values()):
        raise OperationError(
            f"{source}: no odometry can be used ({'; '.join(unsound)}); mend what sends it, and "
            "record anew"
        )
    if not robots:
        raise InputError(f"{source}: no odometry of a robot is in it; record a drive")
    if robots.isdisjoint(inputs.site.robots):
        raise InputError(
            f"{source}: it is of robot {', '.join(sorted(robots))}, and the site file has only "
            f"{', '.join(sorted(inputs.site.robots))}; use the same names"
        )
    return replayed(pipeline, _told(found.in_order, step))


def _told(
    messages: Iterable[tuple[str, Message | Readings]], step: Callable[[int], None]
) -> Iterator[tuple[str, Message | Readings]]:
    for node, message in messages:
        yield node, message
        step(len(message) if isinstance(message, Readings) else 1)
