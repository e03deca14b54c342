"""The robot bridge: latency, the gate, protocols under nonsense."""
