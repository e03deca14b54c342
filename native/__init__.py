"""The compiled core: what is numbers in tight loops, in C++ (`src`); data in, data out."""
