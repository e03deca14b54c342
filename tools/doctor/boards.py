"""`doctor`'s checks of a site's pictures, if they are files on this machine."""

from itertools import islice

from trigpoint.base.checks import Check
from trigpoint.base.errors import TrigpointError
from trigpoint.edge.detector import detector_for
from trigpoint.site.config import Site
from trigpoint.site.target import load_target
from trigpoint.tools.pictures.account import PictureAccount
from trigpoint.tools.pictures.detect import stills

from .cameras import STILL_SCHEMES

# This many pictures suffice to see how a board is printed, and take a second.
_PICTURES = 10


def check_boards(site: Site, camera: str) -> list[Check]:
    """Boards that the target files describe wrongly; live cameras are left to their agents."""
    config = site.camera(camera)
    if config.scheme not in STILL_SCHEMES or config.file is None:
        return []
    try:
        targets = [load_target(site.path(name)) for name in site.target_names]
        detector = detector_for(targets)
        account = PictureAccount()
        for still in islice(stills([site.path(config.file)], account=account), _PICTURES):
            detector.detect(still.picture)
        said = account.lines()
    except TrigpointError as reason:
        return [Check(f"pictures of {camera}", "warning", str(reason), "mend the source")]
    pictures = [Check(f"pictures of {camera}", "warning", line) for line in said]
    # Each says what is wrong, and after the last semicolon what to do.
    boards = [
        Check(f"boards of {camera}", "error", *s.rpartition("; ")[::2])
        for s in detector.misdescribed
    ]
    return pictures + boards
