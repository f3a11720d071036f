"""Compare refractive indices with n_d and V_d in the catalogue."""

import pytest

from robustflow.core.errors import UsageError
from robustflow.corruptions.optics.lens import SELLMEIER, abbe_number, refractive_index

# n_d and V_d as printed in the Schott data sheets.
CATALOGUE = {
    "N-FK51A": (1.48656, 84.47),
    "N-BK7": (1.51680, 64.17),
    "N-BAK4": (1.56883, 55.98),
    "N-SK16": (1.62041, 60.32),
    "N-F2": (1.62005, 36.43),
    "N-SF5": (1.67271, 32.25),
    "N-SF11": (1.78472, 25.68),
    "N-SF6": (1.80518, 25.36),
    "N-SF66": (1.92286, 20.88),
    "N-LASF9": (1.85025, 32.17),
}


@pytest.mark.parametrize("name", CATALOGUE)
def test_index_and_dispersion_are_those_of_the_data_sheet(name):
    n_d, v_d = CATALOGUE[name]
    assert refractive_index(name, 0.5875618) == pytest.approx(n_d, abs=6e-6)
    assert abbe_number(name) == pytest.approx(v_d, abs=6e-3)


def test_every_glass_disperses_normally():
    for name in SELLMEIER:
        values = [refractive_index(name, w) for w in (0.41, 0.46, 0.54, 0.64, 0.69)]
        assert values == sorted(values, reverse=True)
        assert 1.4 < values[-1] < values[0] < 2.1


def test_an_unknown_glass_is_refused_with_the_nearest_name():
    with pytest.raises(UsageError, match="did you mean 'N-BK7'"):
        refractive_index("NBK7", 0.5)
