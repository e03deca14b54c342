"""One module per protocol; `trigpoint.robot.protocol` has the table of them."""
