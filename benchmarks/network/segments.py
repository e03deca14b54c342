"""A secured site in segments of a network: a namespace for each, tied to the router's by a link of
its own that delays and loses; and programs in them."""

import subprocess
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import IO

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


class Child:
    """A module as a program in a namespace, which is told lines and says some; it is killed with
    the stack."""

    def __init__(self, space: Namespace, stack: ExitStack, *words: str) -> None:
        line = space.command(sys.executable, "-m", *words)
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(line, text=True, stdin=pipe, stdout=pipe)
        stack.callback(self.process.wait)
        stack.callback(self.process.kill)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.input: IO[str] = self.process.stdin
        self.output: IO[str] = self.process.stdout

    def tell(self, text: str) -> None:
        self.input.write(f"{text}\n")
        self.input.flush()

    def line(self) -> str:
        """The next that it says, waited for; raises RuntimeError where it has ended."""
        text = self.output.readline()
        if not text:
            raise RuntimeError(f"a program of the benchmark ended with {self.process.wait()}")
        return text


def certify(folder: Path, nodes: Iterable[tuple[Kind, str]], addresses: Iterable[str] = ()) -> None:
    """Found the site «lab»'s authority, and give certificates to its router «hall», which is at
    these addresses, and to these nodes; in `secure`, where a site file in the folder finds them."""
    authority = Authority("lab", folder / "authority", folder / "secure")
    authority.create()
    router = Identity("lab", Kind.ROUTER, "hall")
    authority.issue(router, _DAYS, addresses_of(Kind.ROUTER, list(addresses)))
    for kind, name in nodes:
        authority.issue(Identity("lab", kind, name), _DAYS, ())
