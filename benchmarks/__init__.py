"""Ratios of Trigpoint against the bare libraries below it, measured side by side in one run.

`BENCHMARKS` in `table` names them all; `python -m benchmarks` runs them.
"""
