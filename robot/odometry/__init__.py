"""What the wheels say, stamped by this machine's clock, with what is known of its noise."""
