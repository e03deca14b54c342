"""Where a network says something else of a small session than the oracle does."""

from collections.abc import Mapping

from support.oracle.verdict import Place, Verdict, is_one_place

from trigpoint.map.network import CameraRecord

# An alternative of which the oracle says less need not be named.
_WORTH_NAMING = 1e-2


def disagreements(
    verdicts: Mapping[str, Verdict], cameras: Mapping[str, CameraRecord]
) -> list[str]:
    """One line for each. A verdict that hangs on the last factor of 30 in the odds, where two
    approximations may differ, is compared only by the place of a camera that is located."""
    lines = []
    for name, verdict in verdicts.items():
        said = cameras[name]
        is_located = said.status == "located"
        if verdict.is_clear() and is_located != verdict.is_located:
            lines.append(
                f"{name} is {said.status}; the oracle puts {verdict.elsewhere:.1e} elsewhere, "
                f"{verdict.by_wrong:.1e} to wrong sightings, {verdict.by_lift:.1e} to lifts"
            )
        elif is_located and not _is_at(verdict.places[0], said):
            lines.append(f"{name} is located elsewhere than the oracle's best place")
        elif not is_located:
            lines += _unnamed(name, verdict, said)
    return lines


def _is_at(place: Place, said: CameraRecord) -> bool:
    assert said.map_from_camera is not None
    return is_one_place(place, said.map_from_camera.pose, said.covariance_matrix)


def _unnamed(name: str, verdict: Verdict, said: CameraRecord) -> list[str]:
    """Places that are left open and not among the alternatives, where any are named."""
    alternatives = getattr(said, "alternatives", ())
    if not alternatives:
        return []
    lines = []
    for place in verdict.places:
        named = any(
            is_one_place(place, one.map_from_camera.pose, place.covariance) for one in alternatives
        )
        if place.mass > _WORTH_NAMING and not named:
            where = ", ".join(f"{value:.2f}" for value in place.map_from_camera.translation)
            lines.append(f"{name}: {place.mass:.2f} at {where} is not among the alternatives")
    return lines
