"""The robot bridge: latency from exposure to correction."""
