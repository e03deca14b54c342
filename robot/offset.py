"""What turns this machine's monotonic clock into Unix time."""

from trigpoint.clock import Clock

from .bridge import Offset


def measured_offset(clock: Clock) -> Offset:
    """Unix time minus the monotonic clock, from the tightest of a few pairs of readings."""
    best_ns, offset_ns = None, 0
    for _ in range(5):
        before_ns, now_ns, after_ns = clock.elapsed_ns(), clock.now_ns(), clock.elapsed_ns()
        if best_ns is None or after_ns - before_ns < best_ns:
            best_ns = after_ns - before_ns
            offset_ns = now_ns - (before_ns + after_ns) // 2
    return Offset(offset_ns)
