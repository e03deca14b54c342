"""A secured site in segments of a network: a namespace for each, tied to the router's by a link of
its own that delays and loses."""

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from trigpoint.contract.access import Identity, Kind
from trigpoint.tools.secure.authority import Authority, addresses_of

from .impairment import Impairment, Link, Namespace

PORT = 7447
_DAYS = 90


class Segments:
    """`router`, the router's namespace, `spaces` and `links` by name, and `addresses`, the router's
    in each; all of it ends with the stack."""

    def __init__(self, names: Iterable[str], impairment: Impairment, stack: ExitStack) -> None:
        self.router = _space(stack)
        self.spaces: dict[str, Namespace] = {}
        self.links: dict[str, Link] = {}
        self.addresses: dict[str, str] = {}
        for number, name in enumerate(names):
            self.spaces[name] = _space(stack)
            self.addresses[name] = f"10.77.{number}.1"
            ends = self.router, self.spaces[name]
            both = self.addresses[name], f"10.77.{number}.2"
            self.links[name] = stack.enter_context(Link(ends, both, impairment, seed=number))


def _space(stack: ExitStack) -> Namespace:
    space = Namespace()
    stack.callback(space.close)
    return space


def certify(folder: Path, nodes: Iterable[tuple[Kind, str]], addresses: Iterable[str] = ()) -> None:
    """Found the site «lab»'s authority, and give certificates to its router «hall», which is at
    these addresses, and to these nodes; in `secure`, where a site file in the folder finds them."""
    authority = Authority("lab", folder / "authority", folder / "secure")
    authority.create()
    router = Identity("lab", Kind.ROUTER, "hall")
    authority.issue(router, _DAYS, addresses_of(Kind.ROUTER, list(addresses)))
    for kind, name in nodes:
        authority.issue(Identity("lab", kind, name), _DAYS, ())
