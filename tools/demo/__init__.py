"""The demo: the whole system on this machine around a simulated lab, held against the truth."""
