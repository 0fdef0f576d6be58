"""Where organs stand: whorls, the recursion, L-systems and random places."""

import math

import numpy as np
import pytest

import petalfit as pf
from petalfit.flowers import GOLDEN_ANGLE, rewrite


def test_each_whorl_stands_in_the_gaps_of_the_one_before():
    azimuth, rank = pf.whorls(3, 3)
    np.testing.assert_allclose(np.diff(np.sort(azimuth % math.tau)), math.tau / 6)
    assert rank.tolist() == [0, 0, 0, 1, 1, 1]


def test_the_recursion_turns_by_the_golden_angle_and_steps_inwards():
    azimuth, rank = pf.recursion(100, growth=0.9)
    np.testing.assert_allclose(np.diff(azimuth), GOLDEN_ANGLE)
    np.testing.assert_allclose(np.diff(rank)[1:] / np.diff(rank)[:-1], 0.9)
    assert (rank[0], rank[-1]) == (0.0, pytest.approx(1.0))
    # The three-gap theorem: with this angle no gap is more than φ² of the smallest.
    gaps = np.diff(np.sort(azimuth % math.tau), append=np.sort(azimuth % math.tau)[0] + math.tau)
    assert gaps.max() / gaps.min() < 2.7


def test_an_l_system_draws_what_the_recursion_and_the_whorls_do():
    spiral = pf.l_system("A", {"A": "O+^A"}, 20)
    for drawn, placed in zip(spiral, pf.recursion(20), strict=True):
        np.testing.assert_allclose(drawn, placed, atol=1e-12)
    rule = {"A": "[O][++O][++++O]+^A"}
    drawn = pf.l_system("A", rule, 4, math.pi / 3)
    placed = pf.whorls(3, 3, 3, 3)
    np.testing.assert_allclose(drawn.rank, placed.rank, atol=1e-12)
    np.testing.assert_allclose(
        np.exp(1j * drawn.azimuth).reshape(4, 3),
        np.exp(1j * placed.azimuth).reshape(4, 3),
        atol=1e-12,
    )


def test_symbols_are_rewritten_all_at_once():
    """Lindenmayer's algae: Fibonacci numbers."""
    assert [len(rewrite("A", {"A": "AB", "B": "A"}, n)) for n in range(7)] == [
        1,
        2,
        3,
        5,
        8,
        13,
        21,
    ]


def test_random_places_are_the_seeds_and_apart():
    one, same, other = pf.scattered(60, 1), pf.scattered(60, 1), pf.scattered(60, 2)
    assert np.array_equal(one.azimuth, same.azimuth)
    assert not np.allclose(one.azimuth, other.azimuth)
    assert (np.diff(one.rank) >= 0).all()
    assert one.rank.min() >= 0
    assert one.rank.max() <= 1
    radius = 1 - one.rank
    xy = np.stack([radius * np.cos(one.azimuth), radius * np.sin(one.azimuth)], axis=-1)
    gaps = np.linalg.norm(xy[:, None] - xy, axis=-1) + np.eye(60)
    assert gaps.min() > 0.05  # sixty independent points come as near as 0.01


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: pf.whorls(), "must be 1 organ"),
        (lambda: pf.whorls(3, 0), "1 organ or more; received 3, 0"),
        (lambda: pf.recursion(-2), "received -2"),
        (lambda: pf.recursion(5, growth=0.0), "growth must be positive"),
        (lambda: pf.recursion(5000, growth=2.0), "nearer to 1"),
        (lambda: pf.scattered(0, 0), "received 0"),
        (lambda: pf.l_system("A", {"A": "AA"}, 60), "give fewer generations"),
        (lambda: pf.l_system("A", {}, 2), "puts no organ"),
        (lambda: pf.l_system("O]", {}, 0), "without its \\["),
        (lambda: pf.l_system("O", {}, -1), "generations must be 0 or more"),
    ],
)
def test_what_cannot_be_placed_is_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()
