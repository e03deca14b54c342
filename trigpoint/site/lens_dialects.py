"""Lens files as people have them, whatever wrote them: what they say, under the names of ROS.

Read are ROS's camera_info (YAML, `.ini`, `ros2 topic echo`), OpenCV's FileStorage (YAML, XML,
JSON), Kalibr's camchain, EuRoC's sensor.yaml, ORB-SLAM's and camodocal's settings, and MATLAB's
`jsonencode(toStruct(cameraParams))`.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.geometry.camera import LensModel

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# Keys in small letters without signs, as `_plain` makes them; the first is how ROS writes it.
_WIDTH = ("imagewidth", "width", "w", "camerawidth", "camera1width")
_HEIGHT = ("imageheight", "height", "h", "cameraheight", "camera1height")
_SIZE = ("resolution", "imagesize", "imageresolution", "imgsize")
_MATRIX = ("cameramatrix", "k", "intrinsicmatrix", "mtx", "intrinsics", "cameraintrinsics")
_FX = ("fx", "flx", "camerafx", "camera1fx", "fu", "mu")
_FY = ("fy", "fly", "camerafy", "camera1fy", "fv", "mv")
_CX = ("cx", "ppx", "cameracx", "camera1cx", "cu", "pu", "u0")
_CY = ("cy", "ppy", "cameracy", "camera1cy", "cv", "pv", "v0")
_DISTORTION = (
    *("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoefs", "distcoeff"),
    *("distortion", "distortionparameters", "coeffs", "dist", "d"),
)
_MODEL = ("distortionmodel", "distortiontype", "cameramodel", "cameratype", "modeltype", "model")
_PREFIXES = ("", "camera", "camera1")
_UNNAMED = ("", "pinhole", "perspective", "standard", "camera")
"""Names of a projection that leave the distortion open."""
_CONVERT = "write image_width, image_height, camera_matrix and distortion_coefficients as ROS does"
# What no reader here takes, by how it begins, and what to do.
_BEGIN = 2000
_OTHERS = (
    (
        "CAMERA_ID, MODEL",
        "COLMAP's, whose first pixel has its centre at (0.5, 0.5); take 0.5 off cx and cy, and "
        f"{_CONVERT}",
    ),
    (
        "cameraParameters with properties",
        "what MATLAB prints; in MATLAB: writelines(jsonencode(toStruct(cameraParams)), 'c1.json')",
    ),
    (r"^\s*(fc|cc|kc) = \[", f"Bouguet's Calib_Results.m; {_CONVERT}"),
    (r"lensmodel['\"]?\s*:\s*['\"]LENSMODEL_", f"mrcal's; {_CONVERT}"),
    ("<projection>frame</projection>", "Metashape's; save it there as «OpenCV Camera Calibration»"),
)
_LATER = "; «trigpoint intrinsics» makes one from pictures"


class LensFile(Struct, frozen=True):
    """What a file says. `matrix`: (3, 3); `distortion`: in OpenCV's order of the model."""

    width: int
    height: int
    matrix: np.ndarray
    model: LensModel
    distortion: tuple[float, ...]


def read_dialect(text: str, file: str) -> LensFile:
    """What a lens file of any known dialect says; raise an InputError that names file, key and
    remedy."""
    found = _Keys(_flat(_document(text, file), file), file)
    if "radialdistortion" in found.values:
        return _of_matlab(found)
    _named_model(found)  # another model has other numbers, too
    width, height = _size_of(found)
    matrix = _matrix_of(found)
    distortion = _distortion_of(found)
    model = _model_of(found, len(np.trim_zeros(distortion, "b")))
    return LensFile(width, height, matrix, model, tuple(distortion.tolist()))


class _Keys:
    """A file's values by plain key, looked up under all names that they go by."""

    def __init__(self, values: Mapping[str, Any], file: str) -> None:
        self.values, self.file = values, file

    def first(self, names: Iterable[str]) -> Any:
        """The value of the first of these names that is there, else None."""
        return next((self.values[name] for name in names if name in self.values), None)

    def numbers(self, names: Iterable[str], said: str) -> np.ndarray:
        """A list or matrix of numbers, flat; empty where there is none."""
        value = self.first(names)
        data = value.get("data") if isinstance(value, dict) else value
        try:
            numbers = np.asarray([] if value is None else data, dtype=float).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.array([np.nan])
        if not np.all(np.isfinite(numbers)):
            raise InputError(
                f"{self.file}: {said} needs rows, cols and data (finite numbers); correct it"
            )
        return numbers


def _size_of(found: _Keys) -> tuple[int, int]:
    pair = found.first(_SIZE)
    width, height = pair if isinstance(pair, list) and len(pair) == 2 else (None, None)
    sides = [("image_width", _WIDTH, width), ("image_height", _HEIGHT, height)]
    width, height = (_side(found, key, names, given) for key, names, given in sides)
    return width, height


def _side(found: _Keys, key: str, names: Iterable[str], given: Any) -> int:
    value = _only(found.first(names) if given is None else given)
    if value is None:
        raise InputError(
            f"{found.file}: the key «{key}» is missing: add the size of the pictures that the lens "
            "was calibrated with"
        )
    try:
        number = float(value) if not isinstance(value, bool) else 0.0
    except (TypeError, ValueError):
        number = 0.0
    if number <= 0 or number != round(number):
        raise InputError(f"{found.file}: {key} is «{value}»; it must be a whole number above 0")
    return int(number)


def _only(value: Any) -> Any:
    """The element of a list of one, as XML's words are, else the value."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _matrix_of(found: _Keys) -> np.ndarray:
    singly = [found.first(names) for names in (_FX, _FY, _CX, _CY)]
    numbers = found.numbers(_MATRIX, "camera_matrix")
    if not numbers.size and None not in singly:
        keys = _Keys({"four": [_only(value) for value in singly]}, found.file)
        numbers = keys.numbers(["four"], "fx, fy, cx, cy")
    if numbers.size == 4:  # Kalibr's and EuRoC's intrinsics
        fx, fy, cx, cy = numbers.tolist()
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if numbers.size != 9:
        known = f"camera_matrix has {numbers.size} numbers; it needs 9"
        what = known if numbers.size else "the key «camera_matrix» is missing"
        raise InputError(f"{found.file}: {what}; {_CONVERT}")
    matrix = numbers.reshape(3, 3)
    if not np.any(matrix[:2]):
        raise InputError(
            f"{found.file}: camera_matrix is all zeros, as drivers have it before the camera is "
            f"calibrated{_LATER}"
        )
    if matrix[2, 0] and not np.any(matrix[:2, 2]):
        raise InputError(f"{found.file}: camera_matrix is transposed, as MATLAB's; exchange rows")
    if not np.array_equal(matrix[2], [0, 0, 1]) or matrix[1, 0]:
        raise InputError(f"{found.file}: camera_matrix is no fx 0 cx, 0 fy cy, 0 0 1; correct it")
    if abs(matrix[0, 1]) > 1e-3 * abs(matrix[0, 0]):
        raise InputError(
            f"{found.file}: camera_matrix has a skew of {matrix[0, 1]:g}, which no lens here has; "
            "calibrate without"
        )
    return matrix


def _distortion_of(found: _Keys) -> np.ndarray:
    """The list of coefficients, or k1 k2 p1 p2 k3 … one by one; a fisheye's are k1 k2 k3 k4."""
    if found.first(_DISTORTION) is not None:
        return found.numbers(_DISTORTION, "distortion_coefficients")
    singly = {name: found.first(f"{prefix}{name}" for prefix in _PREFIXES) for name in _SINGLY}
    model = _named_model(found) or LensModel.PLUMB_BOB
    if model is LensModel.EQUIDISTANT:
        names = model.coefficients
        if singly["k1"] is None and singly["k5"] is not None:
            names = ("k2", "k3", "k4", "k5")  # camodocal counts from the third power of the angle
    else:
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    if all(value is None for value in singly.values()):
        raise InputError(
            f"{found.file}: the key «distortion_coefficients» is missing; write it as ROS does, "
            f"with {len(model.coefficients)} zeros where the lens has no distortion"
        )
    given = [0 if singly[name] is None else _only(singly[name]) for name in names]
    return _Keys({"all": given}, found.file).numbers(["all"], "k1, k2, …")


_SINGLY = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


def _named_model(found: _Keys) -> LensModel | None:
    """The model that a file names, None where it leaves that open."""
    if str(_only(found.values.get("fisheyemodel", 0))) not in ("0", "False"):
        return LensModel.EQUIDISTANT
    values = [_only(found.values.get(name)) for name in _MODEL]
    named = [value for value in values if value is not None and _plain(value) not in _UNNAMED]
    for value in named:
        try:
            LensModel(value)
        except ValueError:
            raise InputError(
                f"{found.file}: the lens model «{value}» is not known; use one of "
                f"{', '.join(LensModel)}{_LATER}"
            ) from None
    return LensModel(named[0]) if named else None


def _model_of(found: _Keys, used: int) -> LensModel:
    """The model that is named, else the one that OpenCV means by so many coefficients."""
    named = _named_model(found)
    if named is not None:
        return named
    if used > len(LensModel.RATIONAL_POLYNOMIAL.coefficients):
        raise InputError(
            f"{found.file}: {used} coefficients are a thin prism's or a tilted sensor's, which no "
            f"lens here has; calibrate without{_LATER}"
        )
    plumb_bob = LensModel.PLUMB_BOB
    return plumb_bob if used <= len(plumb_bob.coefficients) else LensModel.RATIONAL_POLYNOMIAL


def _of_matlab(found: _Keys) -> LensFile:
    """MATLAB's struct: sizes are rows and columns, and the first pixel's centre is at (1, 1)."""
    rows, columns = (*found.numbers(["imagesize"], "ImageSize").tolist(), 0, 0)[:2]
    sides = _Keys({"imagewidth": columns, "imageheight": rows}, found.file)
    width, height = _size_of(sides)
    matrix = found.numbers(["k"], "K")
    if not matrix.size and "intrinsicmatrix" in found.values:
        matrix = found.numbers(["intrinsicmatrix"], "IntrinsicMatrix").reshape(3, 3).T.reshape(-1)
    if not matrix.size:
        (fx, fy), (cx, cy) = (
            found.numbers([key], key) for key in ("focallength", "principalpoint")
        )
        matrix = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    matrix = _matrix_of(_Keys({"k": matrix.tolist()}, found.file)) - [[0, 0, 1], [0, 0, 1], [0] * 3]
    radial = (*found.numbers(["radialdistortion"], "RadialDistortion").tolist(), 0, 0)
    tangential = (*found.numbers(["tangentialdistortion"], "TangentialDistortion").tolist(), 0, 0)
    distortion = (*radial[:2], *tangential[:2], radial[2])
    return LensFile(width, height, matrix, LensModel.PLUMB_BOB, distortion)


def _plain(key: object) -> str:
    return re.sub("[^a-z0-9]", "", str(key).lower())


def _flat(document: dict[str, Any], file: str) -> dict[str, Any]:
    """All keys of all levels, plain; the outermost counts. Raises InputError for several lenses."""
    found: dict[str, Any] = {}
    level = [document]
    while level:
        here: dict[str, Any] = {}
        for key, value in (item for mapping in level for item in mapping.items()):
            if list(_mappings(value)):
                continue
            name = _plain(key)
            if here.setdefault(name, value) != value and name in (*_MATRIX, *_FX, *_DISTORTION):
                raise InputError(
                    f"{file}: there are several lenses in it ({', '.join(map(str, document))}); "
                    "write the camera's own into a file of its own"
                )
        found = here | found
        level = [
            deeper for mapping in level for value in mapping.values() for deeper in _mappings(value)
        ]
    return found


def _mappings(value: Any) -> Iterator[dict[str, Any]]:
    """A mapping below a key, or a list's; a matrix with its data is none."""
    if isinstance(value, dict) and "data" not in value:
        yield value
    elif isinstance(value, list):
        yield from (item for item in value if isinstance(item, dict))


def _document(text: str, file: str) -> dict[str, Any]:
    """The mapping in a text, by what it looks like."""
    start = text.lstrip()
    for pattern, words in _OTHERS:
        if re.search(pattern, start[:_BEGIN], re.MULTILINE):
            raise InputError(f"{file}: this is {words}")
    document: Any = None
    if start.startswith("<"):
        document = _of_xml(start, file)
    elif re.search(r"^\[image\]\s*$", start, re.MULTILINE):
        document = _of_ini(start)
    else:
        document = _of_yaml(start, file)
    if not isinstance(document, dict):
        raise InputError(f"{file}: no camera_info (a mapping is needed); {_CONVERT}")
    return document


def _of_yaml(text: str, file: str) -> Any:
    """YAML and JSON; FileStorage's YAML has a head and tags that YAML does not know."""
    from ruamel.yaml import YAML, YAMLError  # as below: most who import this read no such file

    if text.startswith("{"):
        try:
            return json.loads(text)
        except ValueError:
            pass  # YAML's own flow style
    text = re.sub(r"\A%YAML[: ].*", "", text)  # of one line, so that lines keep their numbers
    text = re.sub(r"!!opencv-\S+", "", text)
    try:
        documents = YAML(typ="safe", pure=True).load_all(text)
        return next((one for one in documents if one is not None), None)
    except YAMLError as reason:
        line = getattr(getattr(reason, "problem_mark", None), "line", None)
        where = file if line is None else f"{file}:{line + 1}"
        raise InputError(f"{where}: not valid YAML; mend that line") from None


def _of_xml(text: str, file: str) -> Any:
    from xml.etree import ElementTree

    try:
        return _of_element(ElementTree.fromstring(text))
    except ElementTree.ParseError as reason:
        line = reason.position[0]
        raise InputError(f"{file}:{line}: not valid XML; mend that line") from None


def _of_element(element: "Element") -> Any:
    if len(element):
        return {child.tag: _of_element(child) for child in element}
    return (element.text or "").strip('" \n').split()


def _of_ini(text: str) -> dict[str, Any]:
    """ROS's: a name on a line of its own, its numbers below."""
    found: dict[str, list[str]] = {}
    numbers: list[str] = []
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if words and not _is_number(words[0]):
            numbers = found.setdefault(" ".join(words), [])
        else:
            numbers += words
    return found


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
