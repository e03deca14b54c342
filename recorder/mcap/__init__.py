"""MCAP as bytes: records, chunks, channels; files written, opened, checked; rosbag2's as well."""
