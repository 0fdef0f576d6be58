"""Which surfaces a turn about their axis does not change."""

import pytest

import petalfit as pf
from petalfit.surfaces import is_of_revolution


@pytest.mark.parametrize(
    ("surface", "expected"),
    [
        (pf.Cylinder(), True),
        (pf.Ellipsoid(3.0, 9.0, 3.0), True),
        (pf.Ellipsoid(3.0, 9.0, 3.1), False),
        (pf.CylinderReceptacle(), True),
        (pf.ConeReceptacle(), True),
        (pf.Bowl(), True),
        (pf.Bowl(hollow="printed"), False),
        (pf.Stigma(), True),
        (pf.Pedicel(a_2=0.0), True),
        (pf.Pedicel(), False),
        (pf.Ovary(), False),
        (pf.Anther(), False),
        (pf.PeonyPetal(), False),
        (pf.Stamen(), False),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, bool) else str(value),
)
def test_surfaces_of_revolution_are_known(surface, expected):
    assert is_of_revolution(surface) == expected


def test_a_fit_says_so():
    stigma = pf.Stigma(2.0, 1.0)
    result = pf.fit(pf.Stigma, stigma.sample(600, seed=1, noise=0.01))
    assert "surface of revolution" in result.message
    assert not result.warnings
