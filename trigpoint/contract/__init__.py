"""What goes over the bus: keys, types, CDR, who may, corrections."""
