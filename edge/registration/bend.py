"""What a homography and a lens of two numbers leave of a face's corners: smooth, over the face.

A printed face curls, and a lens is not quite the one of the fit; both move neighbouring corners
alike. Legendre polynomials of the face's coordinates take that up (`native/src/registration`);
their constant and linear parts are the homography's.
"""

from msgspec import Struct

from trigpoint.geometry.rotation import Array


class Bend(Struct, frozen=True, eq=False):
    """A smooth displacement over a face. `middle`, `half`: (2,) of the part of the face that it was
    fitted to; `degree`: of its polynomials, 2 to 4; `values`: (12, 2) of these, pixels."""

    middle: Array
    half: Array
    degree: int
    values: Array
