"""Networks between namespaces of this machine that delay, lose and hold up packets.

Written since not every kernel has netem: two TUN devices in two namespaces, and a thread between
them that lets each packet through when its time has come. What travels is real IP; TCP sees real
losses.
"""

import ctypes
import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

from msgspec import Struct, field

from trigpoint.base.closing import Closing

_TUNSETIFF, _IFF_TUN_NO_PI = 0x400454CA, 0x1001
_CLONE_NEWNET = 0x40000000
_HOLD = "ip link set lo up && echo ready && exec sleep 86400"
_PACKET = 2048
_MTU = 1400
_LOOK_S = 0.05


class NoNamespacesError(Exception):
    """This machine or user cannot make network namespaces; the text says why."""


class Namespace:
    """A network namespace of its own, which ends with the process that holds it."""

    def __init__(self) -> None:
        self._holder = subprocess.Popen(
            ["unshare", "--net", "--", "sh", "-c", _HOLD],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._holder.stdout is not None
        assert self._holder.stderr is not None
        if self._holder.stdout.readline() != "ready\n":
            reason = self._holder.stderr.read().strip().splitlines()
            self.close()
            raise NoNamespacesError(reason[-1] if reason else "unshare --net fails")

    def command(self, *words: str) -> list[str]:
        """A command line that runs in the namespace."""
        return ["nsenter", "--target", str(self._holder.pid), "--net", "--", *words]

    def run(self, *words: str) -> None:
        subprocess.run(self.command(*words), check=True, capture_output=True, timeout=10)

    def tun(self, name: str) -> int:
        """The file descriptor of a new TUN device in the namespace."""
        opened: list[int | OSError] = []
        thread = threading.Thread(target=lambda: opened.append(self._open_tun(name)))
        thread.start()  # a thread of its own, whose namespace may be another
        thread.join()
        if isinstance(opened[0], OSError):
            raise NoNamespacesError(f"/dev/net/tun: {opened[0].strerror}")
        return opened[0]

    def _open_tun(self, name: str) -> int | OSError:
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            with open(f"/proc/{self._holder.pid}/ns/net") as namespace:  # noqa: PTH123
                if libc.setns(namespace.fileno(), _CLONE_NEWNET) != 0:
                    raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
            descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH", name.encode(), _IFF_TUN_NO_PI))
        except OSError as reason:
            return reason
        return descriptor

    def close(self) -> None:
        self._holder.kill()
        self._holder.communicate()


class Impairment(Struct, frozen=True):
    """Of one direction. `delay_s`: on the way; `loss`: the share of packets that are lost;
    `bits_per_s`: how fast they leave; `queue_s`: how long one may wait for that, else it is lost.
    """

    delay_s: float = 0.0
    loss: float = 0.0
    bits_per_s: float = 1e9
    queue_s: float = 0.1


class _Direction(Struct):
    source: int
    sink: int
    free_s: float = 0.0
    waiting: list[tuple[float, int, bytes]] = field(default_factory=list)


class Link(Closing):
    """A cable between two namespaces. `is_up` may be set at any time; so may `impairment`."""

    def __init__(
        self,
        ends: tuple[Namespace, Namespace],
        addresses: tuple[str, str],
        impairment: Impairment,
        *,
        seed: int = 0,
    ) -> None:
        self.impairment, self.is_up = impairment, True
        self._random = random.Random(seed)
        name = f"tp{addresses[0].replace('.', '')[-10:]}"
        self._tuns = [end.tun(name) for end in ends]
        for end, own, other in zip(ends, addresses, reversed(addresses), strict=True):
            end.run("ip", "address", "add", own, "peer", other, "dev", name)
            end.run("ip", "link", "set", name, "mtu", str(_MTU), "up")
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"link {name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        one, other = self._tuns
        ways = [_Direction(one, other), _Direction(other, one)]
        number = 0
        while not self._stopping.is_set():
            readable, _, _ = select.select(self._tuns, [], [], self._patience(ways))
            now_s = time.monotonic()
            for way in ways:
                if way.source in readable:
                    number = self._read(way, now_s, number)
                self._deliver(way, time.monotonic())

    def _patience(self, ways: Sequence[_Direction]) -> float:
        due = [way.waiting[0][0] for way in ways if way.waiting]
        return min(_LOOK_S, max(0.0, min(due) - time.monotonic())) if due else _LOOK_S

    def _read(self, way: _Direction, now_s: float, number: int) -> int:
        """Take in what waits at one end."""
        while True:
            try:
                packet = os.read(way.source, _PACKET)
            except OSError:
                return number
            number += 1
            limits = self.impairment
            begins_s = max(now_s, way.free_s)
            is_lost = self._random.random() < limits.loss or begins_s - now_s > limits.queue_s
            if self.is_up and not is_lost:
                way.free_s = begins_s + 8 * len(packet) / limits.bits_per_s
                heapq.heappush(way.waiting, (way.free_s + limits.delay_s, number, packet))

    def _deliver(self, way: _Direction, now_s: float) -> None:
        while way.waiting and way.waiting[0][0] <= now_s:
            _, _, packet = heapq.heappop(way.waiting)
            if self.is_up:
                with suppress(OSError):
                    os.write(way.sink, packet)

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        for tun in self._tuns:
            os.close(tun)
