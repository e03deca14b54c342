"""The page's first lines: the calibration in a sentence and in a few numbers."""

from trigpoint.tools.networks.noise_words import noise_words
from trigpoint.tools.pages.frame import centimetres, tile, tiles

from .facts import CalibrationResults


def headline(results: CalibrationResults) -> str:
    located, count = len(results.network.located), len(results.network.cameras)
    worst = results.worst
    if worst is None:
        return "No camera could be located"
    if results.contradicted:
        return "Do not use these cameras"
    sigma = centimetres(results.network.cameras[worst].position_sigma)
    if count == 1:
        return f"The camera is located, to {sigma}"
    if located == count:
        return f"All {count} cameras located, each to {sigma} or better"
    return f"{located} of {count} cameras located, each to {sigma} or better"


def summary(results: CalibrationResults) -> str:
    return tiles(
        _located(results), _worst(results), _distance(results), _truth(results), _noise(results),
        _rejected(results),
    )  # fmt: skip


def _located(results: CalibrationResults) -> str:
    located, count = len(results.network.located), len(results.network.cameras)
    cameras = results.network.cameras.values()
    unseen = sum(camera.status == "unseen" and not camera.undetermined for camera in cameras)
    words = "cameras located"
    if unseen:
        words += f"; {unseen} never saw a robot"
    return tile(f"{located} of {count}", words, is_bad=located + unseen < count)


def _worst(results: CalibrationResults) -> str:
    if results.worst is None:
        return ""
    sigma = results.network.cameras[results.worst].position_sigma
    return tile(centimetres(sigma), f"standard deviation of {results.worst}, which is known worst")


def _distance(results: CalibrationResults) -> str:
    expected = results.distances.expected_error_m
    if expected is None:
        return ""
    words = "mean error of the distances between cameras, as the covariance lets one expect"
    return tile(centimetres(expected), words)


def _truth(results: CalibrationResults) -> str:
    if results.error is None or results.error.distance is None:
        return ""
    words = "their mean error in truth; all errors against the joint covariance come to "
    words += f"{results.error.nees:.2f} per degree of freedom"
    return tile(centimetres(results.error.distance), words)


def _noise(results: CalibrationResults) -> str:
    chi2 = results.network.statistics.chi2_per_dof
    if chi2 is None:
        return ""
    return tile(f"{chi2:.2f}", noise_words(chi2, results.noise))


def _rejected(results: CalibrationResults) -> str:
    if not results.sightings:
        return ""
    words = f"of {results.sightings} sightings rejected, since they contradict the rest"
    return tile(str(results.rejected), words)
