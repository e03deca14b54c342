"""Messages of every type as hypothesis draws them, and whether two are the same."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec import Struct
from msgspec.structs import fields

from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    FaceSighting,
    OccupancyGrid,
    Odometry,
    Picture,
    Polygon,
    PoseArray,
    PoseEstimate,
    PoseStamped,
    Sightings,
    Transform,
    Transforms,
)
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel

stamps = st.integers(0, 2**31 * 10**9 - 1)
names = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
numbers = st.floats(-1e6, 1e6)
vectors = arrays(float, 3, elements=numbers)
covariances = arrays(float, (6, 6), elements=numbers)
sizes = st.integers(0, 2**32 - 1)
poses = arrays(float, 6, elements=st.floats(-3.0, 3.0)).map(Pose.from_vector)


@st.composite
def face_sightings(draw: st.DrawFn) -> FaceSighting:
    ids = draw(st.lists(st.integers(0, 2**16 - 1), min_size=1, max_size=20, unique=True))
    pixels = arrays(np.float32, (len(ids), 2), elements=st.floats(-100, 5000, width=32))
    sigma = draw(st.floats(0.0625, 10.0, width=32))
    face = draw(st.integers(-1, 10))
    return FaceSighting(draw(names), face, np.array(ids, np.uint16), draw(pixels), sigma)


@st.composite
def cameras(draw: st.DrawFn) -> CameraModel:
    model = draw(st.sampled_from(LensModel))
    distortion = draw(st.tuples(*[st.floats(-1, 1)] * len(model.coefficients)))
    focal = st.floats(1.0, 1e4)
    return CameraModel(
        draw(st.integers(1, 9999)),
        draw(st.integers(1, 9999)),
        *draw(st.tuples(focal, focal, numbers, numbers)),
        distortion=distortion,
        model=model,
    )


statuses = st.builds(
    DiagnosticStatus,
    st.integers(0, 3),
    names,
    names,
    names,
    st.dictionaries(names, names, max_size=4),
)

odometry = st.builds(Odometry, stamps, names, names, poses, vectors, vectors)
estimates = st.builds(PoseEstimate, stamps, names, poses, covariances)
transforms = st.builds(Transform, stamps, names, names, poses)
corners = arrays(
    np.float32, st.tuples(st.integers(0, 5), st.just(3)), elements=st.floats(-9, 9, width=32)
).map(lambda drawn: drawn.astype(float))
cells = arrays(
    np.int8, st.tuples(st.integers(0, 5), st.integers(0, 5)), elements=st.integers(-1, 100)
)
messages = st.one_of(
    st.builds(
        Sightings, stamps, names, sizes, sizes, st.lists(face_sightings(), max_size=3).map(tuple)
    ),
    odometry,
    estimates,
    st.builds(PoseStamped, stamps, names, poses),
    st.builds(PoseArray, stamps, names, st.lists(poses, max_size=4).map(Pose.stack)),
    st.builds(Picture, stamps, names, names, st.binary(max_size=50)),
    st.builds(CameraInfo, stamps, names, cameras()),
    st.builds(Transforms, st.lists(transforms, max_size=4).map(tuple)),
    st.builds(Polygon, stamps, names, corners),
    st.builds(OccupancyGrid, stamps, names, st.floats(0.0625, 4.0, width=32), poses, cells),
    st.builds(Diagnostics, stamps, st.lists(statuses, max_size=3).map(tuple)),
)


def assert_equal(first: object, second: object, *, atol: float = 1e-15) -> None:
    """Equal field by field, and arrays by type; rotations to `atol`."""
    if isinstance(first, Pose):
        assert isinstance(second, Pose)
        np.testing.assert_allclose(first.rotation, second.rotation, rtol=0, atol=atol)
        np.testing.assert_array_equal(first.translation, second.translation)
    elif isinstance(first, np.ndarray):
        assert isinstance(second, np.ndarray)
        assert first.dtype == second.dtype
        np.testing.assert_array_equal(first, second)
    elif isinstance(first, tuple):
        assert isinstance(second, tuple)
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            assert_equal(one, other, atol=atol)
    elif isinstance(first, Struct):
        assert type(first) is type(second)
        for field in fields(first):
            assert_equal(getattr(first, field.name), getattr(second, field.name), atol=atol)
    else:
        assert first == second
