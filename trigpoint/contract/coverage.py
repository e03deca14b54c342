"""What the numbers of `{site}/coverage` say of a cell of the floor."""

UNKNOWN = -1
"""Nothing says that it is floor."""
MOST_MM = 99
"""Up to here: the radius of 95 % of a corrected robot's errors, whole millimetres; or more."""
NOT_CORRECTED = 100
