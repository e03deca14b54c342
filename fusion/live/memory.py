"""Returns the memory of large arrays to the system as soon as they are freed.

glibc takes an array that is larger than a limit from the system and returns it when freed, but
raises that limit to the size of the array. From then on the arrays of a long session's solutions
lie among small objects that stay, and their memory stays with them.
"""

import ctypes

# Bytes; smaller than the covariance of a hundred cameras, larger than what a sighting needs.
LARGE = 1 << 20
_M_MMAP_THRESHOLD = -3  # of malloc.h


def return_large_arrays() -> None:
    """Fix glibc's limit for this process; where there is another C library, nothing happens."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_MMAP_THRESHOLD, LARGE)
