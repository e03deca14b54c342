"""One module per protocol; `trigpoint.robot.line.protocol` has the table of them."""
