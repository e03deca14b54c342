"""`calibrate --network` with an old network, whose cameras crept since."""

from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from scipy.special import chdtri
from support.fusion.drives import CameraPlan, Plan, Session, lab_plan, make_session, offline

from trigpoint.base.errors import InputError
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.inputs import load_known
from trigpoint.map.network import load_network

DAY_NS = 86_400 * 10**9
# Ten times what is usual, so that 400 days are more than what a drive leaves open.
CREEP = "creep_translation = 2e-3\ncreep_rotation = 1e-3"
DRAWS = 5


def crept(plan: Plan, days: float, seed: int) -> Plan:
    """The plan with every camera a walk of so many days further."""
    random = np.random.default_rng(seed)
    sigmas = np.repeat([2e-3, 1e-3], 3) * np.sqrt(days)
    cameras: dict[str, CameraPlan] = {}
    for name, camera in plan.cameras.items():
        pose = camera.map_from_camera.disturbed(sigmas * random.normal(size=6))
        cameras[name] = replace(camera, map_from_camera=pose, more=CREEP)
    return replace(plan, cameras=cameras, seed=seed)


@pytest.fixture(scope="module")
def old(charuco_results: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("old")
    charuco_results.save(folder)
    return folder


def aged(folder: Path, results: Results, days: float, out: Path) -> Path:
    """The network as though it had been made so many days earlier."""
    until_ns = results.network.until_ns
    assert until_ns is not None
    network = structs.replace(results.network, until=str(until_ns - round(days * DAY_NS)))
    replace(results, network=network).save(out)
    return out


def nees(session: Session, results: Results) -> float:
    found = session.error(results).nees
    assert found is not None
    return found * 6 * len(results.network.located)


def test_cameras_that_crept_are_honest_over_drawn_days(
    charuco: Session, charuco_results: Results, old: Path, tmp_path: Path
) -> None:
    squares, without = [], []
    for seed in range(DRAWS):
        days = float(np.random.default_rng(seed).uniform(5.0, 400.0))
        plan = crept(replace(charuco.plan, seconds=12.0, picture_rate=1.0), days, 50 + seed)
        session = make_session(plan)
        folder = aged(old, charuco_results, days, tmp_path / str(seed))
        known = load_known(folder, session.inputs.site)
        results = offline(replace(session, inputs=replace(session.inputs, known=known)))
        assert results.network.located == ["c1", "c2", "c3"]
        squares.append(nees(session, results))
        still = replace(known, until_ns=None)  # as though nothing crept
        prior = session.truth_file.cameras
        apart = [known.poses[n].difference(prior[n].pose) for n in known.poses]
        error = np.concatenate(apart)
        without.append(float(error @ still.information @ error))
    freedom = 18 * DRAWS
    low, high = chdtri(freedom, [1 - 1e-4, 1e-4])
    assert low < sum(squares) < high
    assert sum(without) > 3 * high  # the old network alone says too much


def test_network_says_of_which_time_it_is(charuco: Session, charuco_results: Results) -> None:
    seen = [m.stamp_ns for n, m in charuco.messages if n != "r1" and m.faces]  # pyright: ignore
    assert charuco_results.network.until_ns == max(seen)


def test_file_without_a_time_is_read_and_widens_by_nothing(
    charuco: Session, charuco_results: Results, tmp_path: Path
) -> None:
    network = structs.replace(charuco_results.network, until=None)
    replace(charuco_results, network=network).save(tmp_path)
    text = (tmp_path / "network.json").read_text()
    (tmp_path / "network.json").write_text(text.replace(',\n "until": null', ""))
    assert "until" not in (tmp_path / "network.json").read_text()
    known = load_known(tmp_path, charuco.inputs.site)
    assert known.at(charuco.messages[0][1].stamp_ns + 900 * DAY_NS) is known  # pyright: ignore


def test_time_that_is_none_is_refused(
    charuco: Session, charuco_results: Results, tmp_path: Path
) -> None:
    network = structs.replace(charuco_results.network, until="yesterday")
    replace(charuco_results, network=network).save(tmp_path)
    with pytest.raises(InputError, match="until «yesterday» is no stamp"):
        load_network(tmp_path)
    assert charuco.inputs.site.cameras["c1"].creep_translation == 2e-4


# The usual in minutes, however little that is; and as large in these seconds as it is in weeks.
@pytest.mark.parametrize("creep", [2e-4, 1.0])
def test_a_session_widens_by_the_age_of_its_sightings(creep: float) -> None:
    """One that goes on for weeks is a mean over them."""
    plan = lab_plan(seconds=10.0, picture_rate=1.0)

    def found(translation: float) -> Results:
        more = f"creep_translation = {translation}\ncreep_rotation = 0.0"
        cameras = {name: replace(camera, more=more) for name, camera in plan.cameras.items()}
        return offline(make_session(replace(plan, cameras=cameras)))

    still, wide = found(0.0), found(creep)
    for name in ("c1", "c2"):  # which saw it for seconds
        before, after = (r.network.cameras[name].covariance_matrix for r in (still, wide))
        added_s = (np.diagonal(after - before)[:3]) / creep**2 * 86_400
        assert np.all((added_s > 0.5) & (added_s < 10.0))
        np.testing.assert_allclose(added_s, added_s[0], rtol=1e-3)
        np.testing.assert_allclose(np.diagonal(after - before)[3:], 0.0, atol=1e-12)
