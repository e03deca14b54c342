"""The study: simulated sessions of every situation against the Cramér-Rao bound, and drawn
compositions against their truth. `store` keeps and runs both, `command` is their command line.
"""
