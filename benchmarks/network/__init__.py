"""The bus: its latency, its messages, bad networks and secured routers."""
