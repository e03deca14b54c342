"""Who is heard: nobody from the future, nobody twice, nobody without measure."""

from pathlib import Path

from support.builders import make_site

from trigpoint.base.clock import to_ns
from trigpoint.bus.bus import Sample
from trigpoint.contract import topics
from trigpoint.fusion.intake.admission import AHEAD_NS, Admission, Budget

NOW_NS = to_ns(1e9)
ODOM = topics.ODOMETRY.key("lab", "r1")
SIGHTINGS = topics.SIGHTINGS.key("lab", "c1")


def sample(sender: str = "a", *, key: str = ODOM, received_ns: int = NOW_NS) -> Sample:
    return Sample(key, b"", "", received_ns, received_ns, sender=sender)


def heard(
    admission: Admission, senders: str, *, period_s: float = 0.1, start_s: float = 0.0
) -> str:
    """Samples of these senders one after the other; those that were taken."""
    taken = ""
    for number, sender in enumerate(senders):
        at_ns = to_ns(start_s + number * period_s)
        now_ns = NOW_NS + at_ns
        if admission.takes(sample(sender, received_ns=now_ns), now_ns, at_ns):
            taken += sender
    return taken


def test_unknown_name_is_counted_and_not_kept() -> None:
    admission = Admission(make_site())
    for number in range(20_000):
        assert not admission.knows(topics.SIGHTINGS.key("lab", f"x{number}"))
    assert admission.knows(ODOM)
    assert admission.counts == {"unknown_sender": 20_000}


def test_what_is_stamped_far_ahead_is_refused_and_said_and_the_next_one_is_taken() -> None:
    admission = Admission(make_site())
    assert not admission.takes(sample(), NOW_NS + to_ns(3600.0), 0)
    [text] = admission.troubles(0).values()
    assert "3600 s ahead of this machine's clock" in text
    assert admission.takes(sample(), NOW_NS + AHEAD_NS - 1, 1)
    assert not admission.troubles(to_ns(5.0))


def test_clock_of_this_machine_that_was_set_back_refuses_nobody() -> None:
    admission = Admission(make_site())
    set_back = sample(received_ns=NOW_NS - to_ns(60.0))
    assert not admission.takes(set_back, NOW_NS, 0)
    assert admission.takes(set_back, NOW_NS, 0, set_by_ns=-to_ns(60.0))


def test_two_senders_under_one_name_are_named_and_neither_is_used() -> None:
    admission = Admission(make_site())
    assert heard(admission, "aaaa" + "ab" * 20).strip("a") == ""
    assert heard(admission, "ab" * 20, start_s=5.0) == ""
    [text] = admission.troubles(to_ns(9.0)).values()
    assert "the sessions a and b; neither is used" in text


def test_stray_message_of_another_costs_nothing() -> None:
    admission = Admission(make_site())
    assert heard(admission, "aaaaabaaaaa") == "a" * 10
    assert not admission.troubles(to_ns(1.0))


def test_restarted_sender_takes_over_once_the_first_is_silent() -> None:
    admission = Admission(make_site())
    assert heard(admission, "aaaaa") == "aaaaa"
    assert heard(admission, "bbb", start_s=0.6) == ""
    assert heard(admission, "bbbbb", start_s=1.5) == "bbbbb"
    assert not admission.troubles(to_ns(2.0))


def test_one_of_two_that_stays_is_used_again() -> None:
    admission = Admission(make_site())
    heard(admission, "ab" * 10)
    assert heard(admission, "b" * 100, start_s=2.0).endswith("b" * 40)
    assert not admission.troubles(to_ns(12.0))


def test_flood_is_thinned_to_twice_what_the_camera_can_send(tmp_path: Path) -> None:
    admission = Admission(make_site())
    taken = 0
    for number in range(60_000):  # a minute at 1 kHz of a camera of 10 Hz
        at_ns = number * to_ns(0.001)
        one = sample(key=SIGHTINGS, received_ns=NOW_NS + at_ns)
        taken += admission.takes(one, NOW_NS + at_ns, at_ns)
    assert taken <= topics.SIGHTINGS.cache + 60 * 20 + 1
    assert admission.counts["shed"] == 60_000 - taken
    assert "more than twice the messages" in next(iter(admission.troubles(to_ns(60.0)).values()))


def test_session_that_is_replayed_faster_is_no_flood() -> None:
    budget = Budget(20.0, 10)
    assert all(budget.takes(to_ns(number * 0.1), number) for number in range(1000))
