import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.contract.topics import (
    CORRECTION,
    ODOMETRY,
    TF,
    TOPICS,
    Delivery,
    Topic,
    alive_key,
    command_key,
    key_matches,
    node_of,
    topic_of,
)

chunks = st.text("ab", min_size=1, max_size=2)
keys = st.lists(chunks, min_size=1, max_size=5)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_key_is_found_again_by_its_row(topic: Topic) -> None:
    key = topic.key("lab", "n1")
    assert topic_of(key) is topic
    assert key_matches(topic.expression("lab"), key)
    assert not key_matches(topic.expression("hall"), key)
    assert topic.match(key) == ("lab", "n1" if "{id}" in topic.path else "")


def test_keys_and_encodings_are_the_contracts() -> None:
    assert ODOMETRY.key("lab", "r1") == "lab/robot/r1/odom"
    assert ODOMETRY.encoding == "application/cdr;nav_msgs/msg/Odometry"
    assert TF.key("lab") == "lab/tf"
    assert alive_key("lab", "edge", "c1") == "lab/alive/edge/c1"
    assert command_key("lab", "fusion/map") == "lab/fusion/map"


def test_node_is_read_off_a_key() -> None:
    assert node_of("lab/camera/c1/sightings") == "c1"
    assert node_of("lab/tf") == ""
    assert node_of("lab/unknown/key") == ""
    assert topic_of("lab") is None
    assert topic_of("/tf") is None


def test_what_must_arrive_is_reliable() -> None:
    assert {delivery for delivery in Delivery if not delivery.is_reliable} == {
        Delivery.NEWEST,
        Delivery.BEST_EFFORT,
    }
    assert CORRECTION.delivery is Delivery.URGENT


def test_names_are_given_once() -> None:
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)
    assert len({topic.path for topic in TOPICS}) == len(TOPICS)


@pytest.mark.parametrize(
    ("expression", "key", "expected"),
    [
        ("a/b", "a/b", True),
        ("a/*", "a/b", True),
        ("a/*", "a/b/c", False),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("**/c", "a/b/c", True),
        ("a/**/c", "a/c", True),
        ("a/*/c", "a/c", False),
        ("a", "a/b", False),
        ("a/b", "a", False),
    ],
)
def test_wildcards(expression: str, key: str, expected: bool) -> None:
    assert key_matches(expression, key) is expected


@given(keys, st.data())
def test_a_key_with_wildcards_in_place_of_chunks_matches(
    chunks: list[str], data: st.DataObject
) -> None:
    masked = [data.draw(st.sampled_from([chunk, "*", "**"])) for chunk in chunks]
    assert key_matches("/".join(masked), "/".join(chunks))
