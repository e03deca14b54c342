"""The robot bridge: latency and the gate."""
