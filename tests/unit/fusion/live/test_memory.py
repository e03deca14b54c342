"""What a large array took is given back when it is freed."""

import subprocess
import sys

import pytest

# How many arrays of 4 MB, one after the other, lie in pages of their own, by glibc's count.
CODE = """
import ctypes, sys
import numpy as np
from trigpoint.fusion.live.memory import return_large_arrays

class Counts(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena ordblks smblks hblks hblkhd".split()]
    _fields_ += [(f"other{n}", ctypes.c_size_t) for n in range(5)]

libc = ctypes.CDLL(None)
libc.mallinfo2.restype = Counts
if sys.argv[1] == "fixed":
    return_large_arrays()
apart = 0
for _ in range(5):
    before = libc.mallinfo2().hblks
    array = np.ones(1 << 19)
    apart += libc.mallinfo2().hblks > before
    del array
print(apart)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="about glibc")
@pytest.mark.parametrize(("how", "apart"), [("fixed", 5), ("as it is", 1)])
def test_large_arrays_lie_apart_also_after_others_were_freed(how: str, apart: int) -> None:
    run = [sys.executable, "-c", CODE, how]
    assert int(subprocess.run(run, capture_output=True, text=True, check=True).stdout) == apart
