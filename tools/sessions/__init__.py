"""What the tools read of sessions and foreign bags: messages, site, targets, lenses."""
