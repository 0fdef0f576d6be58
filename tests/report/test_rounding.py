import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from petalfit.report.rounding import count, listed, measured, plain, round_up, ticks


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (14.0848, 0.04536, ("14.085", "0.045")),
        (0.00114, 0.00167, ("0.0011", "0.0017")),
        (-0.00004, 0.00996, ("0.000", "0.010")),
        (-3.14159, 0.5, ("−3.14", "0.50")),
        (1234.56, 78.9, ("1235", "79")),
        (12345.6, 789.0, ("12346", "789")),
        (14.0, 1.2e-9, ("14.000000000", "1.2 × 10⁻⁹")),
        (2.0, math.inf, ("2.000000", "∞")),
        (2.0, 0.0, ("2.000000", "0")),
    ],
)
def test_measured(value, error, expected):
    assert measured(value, error) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0500999, "0.0501"),
        (-12.345, "−12.3"),
        (44.0, "44.0"),
        (1234.5, "1230"),
        (1234567.0, "1.23 × 10⁶"),
        (1.5e-7, "1.50 × 10⁻⁷"),
        (9.999, "10.0"),
        (0.0, "0"),
        (-0.0, "0"),
        (math.nan, "not a number"),
        (-math.inf, "−∞"),
    ],
)
def test_plain(value, expected):
    assert plain(value) == expected


@given(st.floats(-1e12, 1e12, allow_subnormal=False), st.integers(2, 8))
def test_plain_is_within_its_last_digit(value, digits):
    text = plain(value, digits).replace("−", "-")
    head, _, power = text.partition(" × 10")
    exponent = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)
    assert float(head) * 10.0**exponent == pytest.approx(value, rel=0.6 * 10.0 ** (1 - digits))


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e6), st.integers(2, 12))
def test_ticks_are_round_and_inside(low, length, most):
    high = low + length
    found = ticks(low, high, most)
    step = round_up((high - low) / most)
    assert len(found) <= most + 1
    assert all(low - 1e-6 * step <= tick <= high + 1e-6 * step for tick in found)
    assert all(abs(tick / step - round(tick / step)) < 1e-6 for tick in found)


def test_words():
    assert (count(1, "point"), count(1500, "point")) == ("1 point", "1,500 points")
    assert [listed(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == [
        "", "a", "a and b", "a, b and c",
    ]  # fmt: skip
