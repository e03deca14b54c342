import pytest

from trigpoint.fusion.model.thinning import thinned


@pytest.mark.parametrize(
    ("count", "most", "taken"), [(0, 3, []), (3, 3, [0, 1, 2]), (9, 3, [0, 4, 8])]
)
def test_so_many_are_taken_evenly_with_both_ends(count: int, most: int, taken: list[int]) -> None:
    assert thinned(count, most).tolist() == taken
