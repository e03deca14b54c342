"""A node's diagnostics as Prometheus metrics, under documented names."""
