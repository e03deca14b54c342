"""Receives one robot's corrections from the bus, for every kind of robot."""

from collections.abc import Callable

from trigpoint.base.clock import Clock, to_seconds
from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bus, Sample, Subscription
from trigpoint.contract.cdr import decode
from trigpoint.contract.correction import MissedCorrections, decode_mark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CORRECTION
from trigpoint.node.health import Health
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse
from trigpoint.security.authenticator import correction_verifier
from trigpoint.site.config import Site

from .bridge import Bridge
from .line.protocol import RobotCorrection

_TAKE_S = 0.2


class Corrections:
    """`hand_on` gets the corrections that the bridge approved. `is_held`: whether none may be
    passed on now (a ROS 2 robot's stamps are not by this machine's clock, so its corrections are
    never held). Call `subscribed` before starting anything else."""

    def __init__(
        self,
        site: Site,
        bridge: Bridge,
        health: Health,
        clock: Clock,
        hand_on: Callable[[RobotCorrection], None],
        is_held: Callable[[], bool] = bool,
    ) -> None:
        self._verifier = correction_verifier(site, clock)
        self._missed = MissedCorrections()
        self._bridge, self._health, self._clock = bridge, health, clock
        self._hand_on, self._is_held = hand_on, is_held

    def run(self, corrections: Subscription, node: Node, pulse: Pulse) -> None:
        """Judge corrections until the node stops."""
        while not node.stopping.is_set():
            pulse.beat()
            sample = corrections.take(_TAKE_S)
            if sample is not None:
                self.take(sample)

    def take(self, sample: Sample) -> None:
        """Judge one sample."""
        self._health.count(f"received {sample.key}")
        try:
            mark = decode_mark(self._verifier.verify(sample.key, sample.payload, sample.attachment))
            correction = decode(CORRECTION.type_name, sample.payload)
        except MessageError as reason:
            self._health.reject(sample, reason)
            self._bridge.pass_over(f"the last was rejected: {reason}")
            return
        if missing := self._missed.before(mark, sample.sender):
            self._health.lose("corrections", missing)
        if self._is_held():
            self._health.lose("corrections_held_by_the_clock")
            self._bridge.pass_over("the last was held, since the clocks disagreed")
            return
        assert isinstance(correction, PoseEstimate)  # guaranteed by the topic's type
        self._health.observe(
            "correction_transit", to_seconds(sample.received_ns - sample.published_ns)
        )
        self._health.observe(
            "correction_delay", to_seconds(self._clock.now_ns() - correction.stamp_ns)
        )
        now_ns = self._clock.elapsed_ns()
        handed_on = self._bridge.on_correction(correction, mark, now_ns, sample.sender)
        if handed_on is not None:
            self._hand_on(handed_on)


def subscribed(bus: Bus, site: Site, robot: str) -> Subscription:
    """A subscription to one robot's corrections."""
    return bus.subscribe(CORRECTION, CORRECTION.key(site.name, robot))
