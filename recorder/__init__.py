"""The recorder: everything to MCAP and to rerun."""
