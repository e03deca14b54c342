"""Drawn sessions by the contract in which everything happens at once, written with their truth.

They share nothing with fusion: the truth is drawn forwards, with numpy, `trigpoint.geometry` and
the lab's noise and sight (`trigpoint.tools.simulation`).
"""
