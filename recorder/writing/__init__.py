"""From the bus to the disk: what comes in, what waits, the file that is written, the ring."""
