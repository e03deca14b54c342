"""Who may do what on a site's keys: one row per kind of node, turned into Zenoh's access rules.

The rules are enforced where a link from another machine ends: at the gate of a listening machine,
and at routers. Whatever no row allows is denied. Processes on that machine itself meet on loopback
and are not checked. Pure: knows no Zenoh and no files.
"""

from collections.abc import Iterable
from enum import StrEnum

from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.contract import topics
from trigpoint.site.config import Site, check_name

from .topics import Topic, sent_key

_NODES = "*"


class Kind(StrEnum):
    """The kind of node that a certificate's holder is."""

    CAMERA = "camera"
    ROBOT = "robot"
    FUSION = "fusion"
    RECORDER = "recorder"
    OPERATOR = "operator"
    VIEWER = "viewer"
    ROUTER = "router"


class Identity(Struct, frozen=True):
    """The holder of a certificate, by the name in it: «lab/camera/c1»."""

    site: str
    kind: Kind
    name: str

    @property
    def common_name(self) -> str:
        return f"{self.site}/{self.kind}/{self.name}"

    @property
    def stem(self) -> str:
        """The stem of its files: camera-c1 for camera-c1.key and camera-c1.pem."""
        return f"{self.kind}-{self.name}"

    @classmethod
    def parse(cls, common_name: str) -> "Identity | None":
        """The holder named by a certificate; None if it is not one of ours."""
        parts = common_name.split("/")
        if len(parts) != 3 or parts[1] not in set(Kind) or not all(parts):
            return None
        return cls(parts[0], Kind(parts[1]), parts[2])


_ONLY_NAMES = {Kind.FUSION: "fusion", Kind.RECORDER: "main"}


def identity_in(site: Site, kind: Kind, name: str, *, is_known: bool = False) -> Identity:
    """A node of a site by what a person calls it; `is_known`: one that the site file may have had
    before. Raises ConfigError or InputError where there is none."""
    check_name(kind, name)
    if not is_known and kind is Kind.CAMERA:
        site.camera(name)
    if not is_known and kind is Kind.ROBOT:
        site.robot(name)
    only = _ONLY_NAMES.get(kind, name)
    if name != only:
        raise InputError(f"a site's {kind} is called «{only}»; write {kind} {only}")
    return Identity(site.name, kind, name)


class Grants(Struct, frozen=True):
    """What one kind of node may do. Paths are below the site; `{id}` is the node's own name.

    `token`: the liveliness token that it may declare; everyone may see who is alive.
    """

    publishes: tuple[Topic, ...] = ()
    subscribes: tuple[Topic, ...] = ()
    serves: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    token: str = ""
    own: bool = False

    def expression(self, topic: Topic, name: str) -> str:
        """The topic's keys that the grant covers, below the site."""
        return topic.path.format(id=name if self.own else _NODES)


_CAMERA_COMMANDS = ("camera/{id}/snapshot", "camera/{id}/calibrate")
_FUSION_COMMANDS = ("fusion/network", "fusion/map", "fusion/reset", "fusion/learn")
_RECORDER_COMMANDS = ("recorder/*",)

GRANTS: dict[Kind, Grants] = {
    Kind.CAMERA: Grants(
        publishes=(topics.IMAGE, topics.CAMERA_INFO, topics.SIGHTINGS, topics.DIAGNOSTICS),
        subscribes=(topics.DIAGNOSTICS,),
        serves=_CAMERA_COMMANDS,
        asks=("clock",),
        token="alive/edge/{id}",
        own=True,
    ),
    Kind.ROBOT: Grants(
        publishes=(topics.ODOMETRY, topics.CORRECTED, topics.ROBOT_TF, topics.DIAGNOSTICS),
        subscribes=(topics.CORRECTION, topics.ROBOT_POSE, topics.SUGGESTION, topics.DIAGNOSTICS),
        asks=("clock", "fusion/map"),
        token="alive/robot/{id}",
        own=True,
    ),
    Kind.FUSION: Grants(
        publishes=(
            topics.CAMERA_POSE,
            topics.ROBOT_POSE,
            topics.CORRECTION,
            topics.SUGGESTION,
            topics.PARTICLES,
            topics.TF,
            topics.TF_STATIC,
            topics.COVERAGE,
            topics.COVERAGE_GRID,
            topics.DIAGNOSTICS,
        ),
        subscribes=(topics.CAMERA_INFO, topics.SIGHTINGS, topics.ODOMETRY, topics.DIAGNOSTICS),
        serves=(*_FUSION_COMMANDS, "clock"),
        token="alive/fusion/*",
    ),
    Kind.RECORDER: Grants(
        publishes=(topics.DIAGNOSTICS,),
        subscribes=topics.TOPICS,
        serves=_RECORDER_COMMANDS,
        asks=("fusion/network",),
        token="alive/recorder/*",
    ),
    Kind.OPERATOR: Grants(
        subscribes=topics.TOPICS,
        asks=(*_CAMERA_COMMANDS, *_FUSION_COMMANDS, *_RECORDER_COMMANDS, "clock"),
    ),
    Kind.VIEWER: Grants(subscribes=topics.TOPICS),
}
"""Without routers: each enforces the rules on those who connect to it, and relays the rest."""

_ANY = ("**", "**/@adv/**")

_EVERYTHING = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


class _Rule(Struct, frozen=True):
    """Messages allowed from (`ingress`) or to (`egress`) the node, on these keys."""

    flow: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]


def access_control(identities: Iterable[Identity], *, sites: Iterable[str]) -> dict[str, object]:
    """Zenoh's `access_control` for a session to which these nodes connect.

    `sites`: the sites whose keys a connecting router may relay.
    """
    rules: dict[str, _Rule] = {}
    policies: list[dict[str, object]] = []
    subjects: list[dict[str, object]] = [
        {"id": "this machine", "interfaces": ["lo"], "link_protocols": ["tcp"]}
    ]
    local = {f"this machine {flow}": _all_of(flow, ("**",)) for flow in ("ingress", "egress")}
    rules |= local
    policies.append({"rules": list(local), "subjects": ["this machine"]})
    for identity in sorted(set(identities), key=lambda one: one.common_name):
        own = {
            f"{identity.common_name} {n}": rule for n, rule in enumerate(_rules(identity, sites))
        }
        name = identity.common_name
        subjects.append(
            {"id": name, "cert_common_names": [name], "link_protocols": ["tls", "quic"]}
        )
        policies.append({"rules": list(own), "subjects": [name]})
        rules |= own
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [_as_zenoh(name, rule) for name, rule in rules.items()],
        "subjects": subjects,
        "policies": policies,
    }


def _as_zenoh(name: str, rule: _Rule) -> dict[str, object]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [rule.flow],
        "messages": list(rule.messages),
        "key_exprs": list(rule.keys),
    }


def _all_of(flow: str, keys: tuple[str, ...]) -> _Rule:
    return _Rule(flow, _EVERYTHING, (*keys, *(f"{key}/@adv/**" for key in keys)))


def _rules(identity: Identity, sites: Iterable[str]) -> list[_Rule]:
    if identity.kind is Kind.ROUTER:
        keys = tuple(f"{site}/**" for site in sites)
        return [_all_of("ingress", keys), _all_of("egress", keys)]
    grants = GRANTS[identity.kind]

    def keys_of(paths: Iterable[str]) -> tuple[str, ...]:
        name = identity.name if grants.own else _NODES
        return tuple(f"{identity.site}/{path.format(id=name)}" for path in paths)

    puts = keys_of(topic.path for topic in grants.publishes)
    reads = keys_of(topic.path for topic in grants.subscribes)
    rules = [*_publishing(puts), *_subscribing(reads)]
    # Certificates do not name sessions. Answering for another session only costs a wait.
    sent = (sent_key(identity.site, "*"),)
    rules += [*_serving(sent if puts else ()), *_asking(sent if reads else ())]
    rules += [*_serving(keys_of(grants.serves)), *_asking(keys_of(grants.asks))]
    if grants.token:
        rules.append(_Rule("ingress", ("liveliness_token",), keys_of([grants.token])))
    alive = (f"{identity.site}/alive/**",)
    rules.append(
        _Rule("ingress", ("liveliness_query", "declare_liveliness_subscriber"), alive),
    )
    rules.append(_Rule("egress", ("liveliness_token", "reply"), alive))
    return [rule for rule in rules if rule.keys]


def _publishing(keys: tuple[str, ...]) -> list[_Rule]:
    """A publisher with a cache also serves that cache and announces itself, on `@adv` keys."""
    cached = _cache(keys)
    return [
        _Rule("ingress", ("put",), (*keys, *cached)),
        # Subscribers ask for more than this node's key (`lab/camera/*/sightings`). A publisher not
        # told of such a subscription believes that nobody listens.
        _Rule("egress", ("declare_subscriber",), _ANY if keys else ()),
        *_serving(cached),
        _Rule("ingress", ("reply",), keys),
        _Rule("ingress", ("liveliness_token",), cached),
        _Rule("egress", ("declare_liveliness_subscriber", "liveliness_query"), cached),
    ]


def _subscribing(keys: tuple[str, ...]) -> list[_Rule]:
    cached = _cache(keys)
    return [
        _Rule("ingress", ("declare_subscriber",), (*keys, *cached)),
        _Rule("egress", ("put",), (*keys, *cached)),
        *_asking(cached),
        _Rule("egress", ("reply",), keys),
        _Rule("ingress", ("declare_liveliness_subscriber", "liveliness_query"), cached),
        _Rule("egress", ("liveliness_token",), cached),
    ]


def _serving(keys: tuple[str, ...]) -> list[_Rule]:
    return [
        _Rule("ingress", ("declare_queryable", "reply"), keys),
        _Rule("egress", ("query",), keys),
    ]


def _asking(keys: tuple[str, ...]) -> list[_Rule]:
    return [
        _Rule("ingress", ("query",), keys),
        _Rule("egress", ("declare_queryable", "reply"), keys),
    ]


def _cache(keys: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{key}/@adv/**" for key in keys)
