from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import MessageError
from trigpoint.contract.topics import CORRECTION
from trigpoint.node.health import Health, Level
from trigpoint.testing.memory_bus import MemoryBroker


def test_counters_show_total_and_rate_since_the_last_report() -> None:
    clock = ManualClock()
    health = Health(clock)
    health.count("sightings", 10)
    clock.advance(2.0)
    assert health.report().values["sightings.rate"] == "5.0"
    health.count("sightings")
    clock.advance(1.0)
    values = health.report().values
    assert (values["sightings.total"], values["sightings.rate"]) == ("11", "1.0")
    assert health.total("sightings") == 11
    assert health.total("never") == 0


def test_loss_makes_a_warning_for_a_while() -> None:
    clock = ManualClock()
    health = Health(clock)
    assert health.report().level is Level.OK
    health.lose("odometry", 3)
    report = health.report()
    assert (report.level, report.message) == (Level.WARN, "lost so far: 3 odometry")
    assert report.values["odometry.lost"] == "3"
    clock.advance(60.0)
    report = health.report()
    assert (report.level, report.values["odometry.lost"]) == (Level.OK, "3")


def test_a_loss_that_is_counted_from_nothing_on_is_no_new_one() -> None:
    clock = ManualClock()
    health = Health(clock)
    health.lose("file a", 3)
    assert health.report().level is Level.WARN
    clock.advance(60.0)
    health.lose("file b", 0)
    report = health.report()
    assert (report.level, report.values["file b.lost"]) == (Level.OK, "0")


def test_failure_makes_an_error_for_a_while_and_stays_readable() -> None:
    clock = ManualClock()
    health = Health(clock)
    health.fail("the lens is covered")
    report = health.report()
    assert (report.level, report.message) == (Level.ERROR, "the lens is covered")
    clock.advance(60.0)
    report = health.report()
    assert report.level is Level.OK
    assert report.values["last_error"] == "the lens is covered"


def test_durations_are_shown_as_a_histogram() -> None:
    health = Health(ManualClock())
    for seconds in (0.002, 0.004, 0.004):
        health.observe("detection", seconds)
    assert health.report().values["detection.seconds"] == "0.010000 0 1 2"


def test_gauge_is_read_at_each_report() -> None:
    health = Health(ManualClock())
    depths = [1.0, 2.5]
    health.gauge("depth", lambda: depths.pop(0))
    assert [health.report().values["depth"] for _ in range(2)] == ["1", "2.5"]


def test_watched_subscription_shows_depth_total_and_losses() -> None:
    with MemoryBroker().session() as bus:
        subscription = bus.subscribe(CORRECTION, "lab/robot/r1/correction")
        health = Health(ManualClock())
        health.watch("corrections", subscription)
        publisher = bus.publisher(CORRECTION, "lab/robot/r1/correction")
        for _ in range(CORRECTION.queue + 2):
            publisher.put(b"")
        report = health.report()
    assert report.level is Level.WARN
    assert report.values["corrections.total"] == str(CORRECTION.queue + 2)
    assert report.values["corrections.depth"] == str(CORRECTION.queue)
    assert report.values["corrections.lost"] == "2"


def test_rejected_sample_names_its_key_and_sender() -> None:
    health = Health(ManualClock())
    with MemoryBroker().session() as bus:
        subscription = bus.subscribe(CORRECTION, "lab/robot/r1/correction")
        bus.publisher(CORRECTION, "lab/robot/r1/correction").put(b"garbage")
        sample = subscription.take(1.0)
        assert sample is not None
        health.reject(sample, MessageError("7 bytes are no pose"))
        assert health.total("rejected") == 1
        assert health.last_error == (
            f"rejected a sample on lab/robot/r1/correction from session {bus.identity}: "
            "7 bytes are no pose"
        )
