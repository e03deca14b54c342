"""How many cameras one core carries, by the time that their pictures take in a drive's mix."""

from benchmarks.table import Row, share_of
from benchmarks.timing import worked

from .detection import OURS, one_thread, opencv_finders, our_finder, runs
from .views import gallery

RATE_HZ = 5.0
_PICTURES = 48


def run(effort: float = 1.0) -> list[Row]:
    """Cameras of 640 × 480 at 5 Hz: seen by ours and by OpenCV's finders; and simulated ones."""
    count = share_of(_PICTURES, effort)
    with one_thread():
        return [
            *_detected("charuco", count),
            *_detected("checkerboard", count),
            _rendered(count),
        ]


def _detected(choice: str, count: int) -> list[Row]:
    pictures = gallery(choice)
    others = opencv_finders(pictures.target, choice)
    finders = {OURS: our_finder(pictures.target)} | others
    cameras = {
        name: _cameras(run.milliseconds)
        for name, run in runs(finders, pictures.of_the_drive(count)).items()
    }
    return [_row(f"detect {choice}", cameras[OURS], cameras[name], name) for name in others]


def _rendered(count: int) -> Row:
    pictures = gallery("charuco")
    seconds = worked(lambda: pictures.of_the_drive(count))[0]
    return _row("simulate", _cameras(1e3 * seconds / count), 6.0, "the lab's cameras")


def _cameras(milliseconds_a_picture: float) -> float:
    return 1e3 / RATE_HZ / milliseconds_a_picture


def _row(what: str, ours: float, other: float, name: str) -> Row:
    what = f"cameras a core, {what}"
    return Row("capacity", what, "cameras", ours, other, name, more_is_better=True)
