"""The accuracy study: simulated sessions of every situation against the Cramér-Rao bound.

`python -m benchmarks.study run` works sessions out and keeps a JSON line for each, `report` writes
docs/background/accuracy.md from them, `show` prints the measures of one situation.
"""
