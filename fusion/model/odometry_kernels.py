"""What the compiled core makes of a track of odometry (`odometry.cpp`); `OdometryTrack` says what
each takes and gives."""

import numpy as np

from trigpoint.native.library import In, Kernel, Out

from .rest import Rest

_REAL, _WHOLE = np.float64, np.int64
# Stamps, rotations, translations, twists, jumps, gaps; the noise's parts, slip, skid and scales.
_TRACK = (
    *(In(_WHOLE, ("n",)), In(_REAL, ("n", 3, 3)), In(_REAL, ("n", 3)), In(_REAL, ("n", 6))),
    *(In(np.bool_, ("n",)), In(_REAL, ("n",))),
)
_NOISE = In(_REAL, (7,)), float, float, In(_REAL, (2,))
_MOMENTS = In(_WHOLE, ("m",))
_POSE = In(_REAL, (1, 12))

# A track that grows: how many messages of a standstill it keeps; how fast its robot may drive and
# turn; its messages, last interval and standstill (3,), and its tables.
_GROWING = (
    int,
    In(_REAL, (2,)),
    Out(_WHOLE, (3,)),
    *(Out(table.dtype, table.shape) for table in _TRACK),
)
ADDED = Kernel(
    *("tp_odometry_added", Rest, int, *_GROWING, _MOMENTS),
    *(In(_REAL, ("m", 3, 3)), In(_REAL, ("m", 3)), Out(_REAL, (3, 3)), Out(_REAL, (3,))),
    Out(_WHOLE, ("m",)),
)
CARRIED = Kernel(
    *("tp_carried", *_TRACK, _MOMENTS, In(_REAL, ("m",)), In(_REAL, (2,))),
    *(Out(_REAL, ("m", 12)), Out(_REAL, ("m", 6))),
)
TWISTS_ABOUT = Kernel("tp_twists_about", *_TRACK, _MOMENTS, Out(_REAL, ("m", 6)))
MOTION = Kernel(
    *("tp_motion", *_TRACK, _MOMENTS, *_NOISE),
    *(Out(_REAL, ("k", 12)), Out(_REAL, ("k", 6, 6)), Out(_REAL, ("k", 6, 2))),
    Out(np.bool_, ("k",)),
)
CARRIED_ON = Kernel(
    *("tp_carried_on", *_TRACK, int, int, *_NOISE, _POSE, In(_REAL, (6, 6))),
    *(Out(_REAL, (1, 12)), Out(_REAL, (6, 6))),
)
STEP = Kernel(
    *("tp_odometry_step", *_TRACK, int, int, *_NOISE, _POSE, _POSE, In(_WHOLE, ("d",))),
    *(Out(_REAL, ("d", "e")), Out(_REAL, ("d",)), Out(_REAL, ("d", "d"))),
)
