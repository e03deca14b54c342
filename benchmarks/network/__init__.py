"""The bus: its latency, its messages, bad networks; and the web page."""
