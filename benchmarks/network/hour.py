"""An hour on a bad network, beside a twin that is left alone:

    python -m benchmarks network_hour [--minutes 60]

Two secured sites run at the same time, so that whatever else the machine does delays both. Between
any two nodes of each lie two links of 50 ms and 20 Mbit/s. On one site each link loses 5 % of the
packets, and every three minutes the router is killed and is away for three seconds; the other has
neither. Corrections' 99th percentile there is the measure for here.
"""

import os
import threading
from dataclasses import replace
from typing import Annotated

import typer

from .bad_links import BAD, DATAGRAMS, Key, Scenario, line, restarting, run
from .impairment import Impairment

_EVERY_S, _DEAD_S = 180.0, 3.0
_LAST_S = 30.0
"""From the router's last return to the end: who says nothing more is not asked for what it said."""
_LINGER_S = 25.0
"""Longer than the cache of odometry: what comes at all has come."""
UNDISTURBED = Impairment(BAD.delay_s, bits_per_s=BAD.bits_per_s)
Found = dict[str, dict[str, Key]]


def both(seconds: float, returns_s: list[float]) -> Found:
    """What came of each key, in the site that is disturbed and in the one that is not.

    `returns_s` gets when the router was switched on again, each time.
    """
    times = int((seconds - _LAST_S) // _EVERY_S)
    bad = Scenario(
        BAD,
        seconds=seconds,
        action=restarting(_EVERY_S, _DEAD_S, times, returns_s),
        linger_s=_LINGER_S,
        protocols=DATAGRAMS,
    )
    scenarios = {"disturbed": bad, "undisturbed": replace(bad, impairment=UNDISTURBED, action=bool)}
    found: Found = {}
    threads = [
        threading.Thread(target=lambda name=name, one=one: found.update({name: run(one)}))
        for name, one in scenarios.items()
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


def main(minutes: Annotated[float, typer.Option(help="How long.")] = 60.0) -> None:
    """An hour on a bad network, beside a twin that is left alone."""
    returns_s: list[float] = []
    found = both(60 * minutes, returns_s)
    back_s = {
        name: [key.back_s(mended_s) for mended_s in returns_s]
        for name, key in found["disturbed"].items()
    }
    for site, keys in found.items():
        print(site)
        for name, key in sorted(keys.items()):
            print(f"  {line(name, key)}, uncounted {key.uncounted}")
    for name, times_s in sorted(back_s.items()):
        each = ", ".join(f"{time_s:.1f}" for time_s in times_s)
        print(f"{name} back after the router's return: {each} s")
    ratio = [found[site]["correction"].quantile_s(0.99) for site in ("disturbed", "undisturbed")]
    print(f"corrections' p99 over undisturbed: {ratio[0] / ratio[1]:.2f}")
    print(f"load of the last quarter of an hour: {os.getloadavg()[2]:.1f}")
