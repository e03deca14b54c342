from pathlib import Path

import pytest
from support.builders import make_site, site_text

from trigpoint.base.errors import ConfigError
from trigpoint.site.config import endpoint_host, endpoint_port, load_site, parse_site


def refusal(text: str) -> str:
    """The one line with which a site file is refused."""
    with pytest.raises(ConfigError) as caught:
        parse_site(text, directory=Path())
    line = str(caught.value)
    assert "\n" not in line
    return line


def test_shortest_site_has_the_contracts_defaults() -> None:
    site = make_site()
    camera, robot = site.camera("c1"), site.robot("r1")
    assert (camera.width, camera.height, camera.rate, camera.intrinsics) == (640, 480, 10.0, None)
    assert (robot.baud, robot.protocol, robot.planar) == (115200, "trigpoint", True)
    assert (robot.odometry.distance, robot.odometry.heading_turn) == (0.006, 0.006)
    assert (site.fusion.estimator, site.fusion.late) == ("smoother", 1.0)
    assert (site.recorder.directory, site.recorder.pictures) == ("sessions", False)
    assert (site.bus.connect, site.bus.listen, site.bus.scouting) == ((), (), False)


def test_unknown_key_names_line_and_nearest_key() -> None:
    text = site_text(more="[fusion]\ncorection_rate = 5.0")
    line = 1 + text.splitlines().index("corection_rate = 5.0")
    assert refusal(text) == (
        f"site.toml:{line}: fusion.corection_rate is not a known key; "
        "did you mean «correction_rate»?"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("site = ", "not valid TOML"),
        ('site = "lab"', "needs the key «cameras»"),
        (site_text(name="Lab"), "the site's name «Lab» must match"),
        (site_text(name="a__b"), "must match"),
        (site_text(more="[recorder]\npictures = 3"), "recorder.pictures: expected «bool»"),
        (site_text(more="[cameras.c9]\nwidth = 3"), "cameras.c9 needs the key «source»"),
        (site_text(more='[cameras.c9]\nsource = "nowhere"'), "source «nowhere» is no URL"),
        (site_text(more='[cameras.c9]\nsource = "a://b"\nrate = -1.0'), "cameras.c9.rate"),
        (site_text(more='[cameras.c9]\nsource = "a://b"\nrate = inf'), "cameras.c9.rate is inf"),
        (site_text(more="[robots.r9.odometry]\ndistance = inf"), "odometry.distance is inf"),
        (site_text(more='[cameras.c9]\nsource = "a://b"\nline_delay = 30.0'), "30 µs is 30e-6"),
        (site_text(more='[cameras.c9]\nsource = "a://b"\nline_delay = nan'), "line_delay is nan"),
        (site_text(more='[cameras.c9]\nsource = "a://b"\nhorizontal_fov = 1.05'), "write 60.2"),
        (site_text(more="[robots.r9.odometry]\ndistance = -1.0"), "robots.r9"),
        (site_text(more='[fusion]\nestimator = "magic"'), "fusion.estimator"),
        (site_text(more="[fusion.priors]\nevent = 0"), "fusion.priors.event"),
        (site_text(more="[fusion.priors]\nwild_corner = 1.0"), "fusion.priors.wild_corner"),
        (site_text(more="[fusion.priors]\nroom = [30.0, 5.0]"), "fusion.priors.room"),
        (site_text(more="[recorder]\nbudget = 4e5"), "budget is 400000 bytes"),
        (site_text(cameras=0, more="[cameras]"), "at least one camera"),
        ('site = "lab"\n[cameras.c]\nsource="a://"\n[robots.r]\nport="p"', "has no target"),
        (site_text(bus='connect = ["10.0.0.1"]'), "«10.0.0.1» is no endpoint"),
        (site_text(bus='connect = ["foo/10.0.0.1:7447"]'), "«foo/10.0.0.1:7447» is no endpoint"),
        (site_text(bus='connect = ["tcp/10.0.0.1:70000"]'), "is no endpoint"),
        (site_text(bus='listen = ["tcp/0.0.0.0:7447"]'), "can move the robots; secure the site"),
        (site_text(bus="scouting = true"), "scouting can move the robots"),
        (site_text(bus='connect = ["tls/10.0.0.1:7447"]'), "write [bus.tls]"),
        (site_text(bus='connect = ["tcp/10.0.0.1:7447"]\n[bus.tls]'), "in the clear; write tls/"),
        (site_text(bus='connect = ["udp/10.0.0.1:7447"]\n[bus.tls]'), "write tls/… or quic/…"),
        (site_text(bus='connect = ["quic/10.0.0.1:7447"]'), "write [bus.tls]"),
        (site_text(bus='listen = ["tls/10.0.0.1:0"]\n[bus.tls]'), "write one"),
        (site_text(bus="insecure = true\n[bus.tls]"), "insecure = true undoes"),
        (site_text(bus="scouting = true\n[bus.tls]"), "scouting = true undoes"),
        (
            site_text(bus='connect = ["tls/hub:443#verify_name_on_connect=false"]\n[bus.tls]'),
            "sets rules of its own",
        ),
        (site_text(bus='connect = ["tcp/10.0.0.1:0"]'), "has no port"),
        (site_text(bus='listen = "tcp/0.0.0.0:7447"'), "bus.listen"),
    ],
)
def test_bad_site_is_refused_with_one_line(text: str, expected: str) -> None:
    assert expected in refusal(text)


def two_of(kind: str, key: str, one: str, other: str) -> str:
    """A site with two cameras, or robots, more."""
    rest = "" if kind == "cameras" else 'target = "t.toml"\n'
    return "\n".join(
        f'[{kind}.x{number}]\n{rest}{key} = "{place}"' for number, place in enumerate((one, other))
    )


_ONE = "{0}s x0 and x1 have the same `{1}`; give each its own, or start only what is on this"
"""The beginning of a refusal, of a kind and its key."""


@pytest.mark.parametrize(
    ("kind", "key", "one", "other", "said"),
    [
        ("cameras", "source", "v4l2:///dev/video0", "v4l2://0?fourcc=MJPG", _ONE),
        ("cameras", "source", "rtsp://me:secret@10.0.0.7/1", "rtsp://me:secret@10.0.0.7/1", _ONE),
        ("robots", "port", "/dev/ttyUSB0", "/dev/ttyUSB0", _ONE),
        ("robots", "port", "socket://10.0.0.9:23", "socket://10.0.0.9:23", _ONE),
        ("cameras", "source", "dir://none", "dir://none", ""),
        ("cameras", "source", "file:///v.mp4", "file:///v.mp4", ""),
        ("cameras", "source", "sim://c1", "sim://c1", ""),
        ("cameras", "source", "noise://0", "noise://0", ""),
        ("cameras", "source", "rtsp://10.0.0.7/1", "rtsp://10.0.0.7/2", ""),
        ("cameras", "source", "v4l2:///dev/video0", "v4l2:///dev/video2", ""),
        ("robots", "port", "loop://", "loop://", ""),
    ],
)
def test_one_device_for_two_is_refused_where_both_run(
    kind: str, key: str, one: str, other: str, said: str
) -> None:
    """What can be opened twice may be shared."""
    site = parse_site(site_text(more=two_of(kind, key, one, other)), directory=Path())
    refused = ""
    try:
        site.check_one_machine(**{"cameras": (), kind: ("x0", "x1")})
    except ConfigError as reason:
        refused = str(reason)
    assert said.format(kind[:-1], key) in refused
    assert bool(said) == bool(refused)


def test_two_robots_with_one_topic_are_refused() -> None:
    said = "site.toml: robots x0 and x1 have the same `topic`; give each its own"
    assert refusal(site_text(more=two_of("robots", "topic", "/odom", "/odom"))) == said


def test_absent_camera_and_robot_list_the_known_ones() -> None:
    site = make_site(cameras=2)
    with pytest.raises(ConfigError, match="no camera «c9» in the site file; it has c1, c2"):
        site.camera("c9")
    with pytest.raises(ConfigError, match="no robot «r9» in the site file; it has r1"):
        site.robot("r9")


def test_site_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not text"):
        load_site(path)


def test_paths_start_at_the_sites_folder(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(site_text())
    site = load_site(path)
    assert site.path(site.target_name("r1")) == tmp_path / "target.toml"
    assert site.path("/elsewhere") == Path("/elsewhere")
    assert site.text == site_text()


def test_a_robots_own_target_wins() -> None:
    site = make_site(more='[robots.r2]\nport = "p"\ntarget = "own.toml"')
    assert (site.target_name("r1"), site.target_name("r2")) == ("target.toml", "own.toml")
    assert site.first_robot == "r1"


@pytest.mark.parametrize(
    ("endpoint", "host", "port"),
    [
        ("tcp/127.0.0.1:7447", "127.0.0.1", 7447),
        ("tls/hub.example.org:443#verify_name_on_connect=false", "hub.example.org", 443),
        ("tcp/[::1]:0", "[::1]", 0),
    ],
)
def test_endpoint_is_taken_apart(endpoint: str, host: str, port: int) -> None:
    assert (endpoint_host(endpoint), endpoint_port(endpoint)) == (host, port)


def test_a_picture_read_out_from_below_takes_as_long() -> None:
    more = '[cameras.c9]\nsource = "a://b"\nheight = 481\nline_delay = -30e-6'
    camera = parse_site(site_text(more=more), directory=Path()).camera("c9")
    assert camera.readout_s == pytest.approx(0.0144)


def test_site_of_cameras_alone_is_read_and_locates_nothing() -> None:
    site = make_site(robots=0)
    assert site.target_names == ["target.toml"]
    with pytest.raises(ConfigError, match=r"has no robot.*add \[robots.r1\]"):
        _ = site.first_robot


def test_expected_server_is_one_that_there_is() -> None:
    text = site_text()
    assert parse_site(text, directory=Path()).expect is None
    expecting = f'expect = ["fusion"]\n{text}'
    assert parse_site(expecting, directory=Path()).expect == ("fusion",)
    assert "expect" in refusal(f'expect = ["fusoin"]\n{text}')
