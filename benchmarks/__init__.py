"""Ratios of Trigpoint against the bare libraries below it, measured side by side in one run.

`BENCHMARKS` in `table` names them all; `python -m benchmarks` prints it.
"""

import os

# As the programs do it (`trigpoint.cli`): for many small matrices threads are a hindrance, and on a
# busy machine a standstill. Before numpy is imported, and for every process that is begun.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
