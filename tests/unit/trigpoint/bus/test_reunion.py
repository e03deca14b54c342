"""What must be recovered waits until it is known who has what was sent before."""

from trigpoint.bus.reunion import ANNOUNCE_S, Reunion


class Session:
    """Links that come and go; the time stands until a test moves it."""

    def __init__(self, *, has_link: bool) -> None:
        self.has_link, self.now_s = has_link, 100.0
        self.reunion = Reunion(lambda: self.has_link, lambda: self.now_s)


def test_who_never_was_alone_waits_for_nothing() -> None:
    session = Session(has_link=True)
    assert session.reunion.wait_s <= 0


def test_to_nobody_is_sent_at_once() -> None:
    session = Session(has_link=True)
    session.has_link = False
    assert session.reunion.wait_s <= 0


def test_after_a_time_alone_the_first_sample_waits_and_later_ones_with_it() -> None:
    session = Session(has_link=False)
    assert session.reunion.wait_s <= 0
    session.has_link = True
    assert session.reunion.wait_s == ANNOUNCE_S
    session.now_s += 0.75 * ANNOUNCE_S
    assert session.reunion.wait_s == 0.25 * ANNOUNCE_S
    session.now_s += ANNOUNCE_S
    assert session.reunion.wait_s <= 0


def test_link_that_is_lost_again_is_waited_for_anew() -> None:
    session = Session(has_link=False)
    session.has_link = True
    assert session.reunion.wait_s > 0
    session.has_link = False
    assert session.reunion.wait_s <= 0
    session.has_link = True
    assert session.reunion.wait_s == ANNOUNCE_S
