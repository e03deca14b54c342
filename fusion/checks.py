"""What `doctor` asks of fusion on this machine."""

from importlib.metadata import PackageNotFoundError, version

from trigpoint.base.checks import Check
from trigpoint.base.words import install_command


def checks() -> list[Check]:
    """Whether the estimator's libraries are there."""
    found = []
    for package in ("numpy", "opencv-python-headless"):
        try:
            found.append(Check(package, "ok", version(package), ""))
        except PackageNotFoundError:
            found.append(Check(package, "error", "is not installed", install_command("fusion")))
    return found
