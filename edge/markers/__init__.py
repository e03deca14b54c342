"""The search for boards with markers: ChArUco and AprilGrid."""
