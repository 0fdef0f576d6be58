"""Stamens of six kinds and pistils of three, each by what defines it in botany."""

import jax
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import petalfit as pf
from petalfit.flowers import PISTILS, STAMENS
from petalfit.surfaces import Pose


def poses(series: pf.Series) -> Pose:
    with jax.enable_x64(True):
        return jax.vmap(lambda place: place.pose(pf.Bowl()))(series.attachment)


def bases(series: pf.Series) -> np.ndarray:
    return np.asarray(poses(series).translation)


def anthers(series: pf.Series) -> np.ndarray:
    """Middles of the anthers."""
    with jax.enable_x64(True):
        outer = poses(series)
        return np.array([
            Pose(*(np.asarray(leaf[k]) for leaf in jax.tree.leaves(outer)))(
                series.one(k).parts()["anther"][0].translation
            )
            for k in range(len(series))
        ])  # fmt: skip


def bundles(points: np.ndarray, reach: float) -> list[int]:
    """Sizes of the groups whose members are connected by steps shorter than `reach`."""
    gaps = np.linalg.norm(points[:, None] - points, axis=-1)
    _, labels = connected_components(gaps < reach)
    return sorted(np.bincount(labels).tolist())


def joined_filaments(series: pf.Series) -> list[int]:
    return bundles(bases(series), 2 * float(series.organ.filament.r[0]))


def test_monadelphous_filaments_are_one_bundle():
    assert joined_filaments(pf.stamens("monadelphous")) == [10]
    assert joined_filaments(pf.stamens("monadelphous", 24)) == [24]


def test_diadelphous_filaments_are_two_bundles():
    assert joined_filaments(pf.stamens("diadelphous")) == [1, 9]


def test_polyadelphous_filaments_are_several_bundles():
    assert joined_filaments(pf.stamens("polyadelphous")) == [3, 3, 3, 3, 3]
    assert joined_filaments(pf.stamens("polyadelphous", 17)) == [3, 3, 3, 4, 4]


@pytest.mark.parametrize(("kind", "long", "short"), [("tetradynamous", 4, 2), ("didynamous", 2, 2)])
def test_stamens_of_two_lengths(kind, long, short):
    series = pf.stamens(kind)
    heights = series.organ.filament.h
    assert [np.sum(heights == heights.max()), np.sum(heights == heights.min())] == [long, short]
    assert heights.min() < 0.8 * heights.max()
    assert joined_filaments(series) == [1] * (long + short)
    if kind == "tetradynamous":  # the short ones stand outside
        away = np.linalg.norm(bases(series)[:, [0, 2]], axis=1)
        assert away[heights == heights.min()].min() > away[heights == heights.max()].max()


def test_synantherous_anthers_are_joined_and_filaments_free():
    series = pf.stamens("synantherous", 6)
    width = 2 * float(series.organ.anther.r[0] + series.organ.anther.swell[0])
    assert bundles(anthers(series), width) == [6]
    assert joined_filaments(series) == [1] * 6
    # The anthers stand upright, all at one height.
    assert np.ptp(anthers(series)[:, 1]) < 1e-9


@pytest.mark.parametrize("kind", [k for k in STAMENS if k != "synantherous"])
def test_anthers_of_other_kinds_are_free(kind):
    series = pf.stamens(kind)
    assert bundles(anthers(series), 0.5) == [1] * len(series)


def test_a_compound_pistil_is_one_organ_whose_ovaries_join():
    (simple,) = pf.pistils("simple").names
    assert simple == "pistil"
    apart = pf.pistils("apocarpous", 5)
    assert len(apart) == 5
    radius = float(apart.organ.ovary.r[0])
    assert bundles(bases(apart), 2 * radius) == [1] * 5
    joined = pf.pistils("compound", 5)
    assert len(joined) == 1
    ovaries = [p for name, (p, _) in joined.one(0).parts().items() if name.endswith("ovary")]
    assert bundles(np.array([p.translation for p in ovaries]), 2 * radius) == [5]


def test_unknown_kinds_and_numbers_are_refused():
    for call, words in [
        (lambda: pf.stamens("free"), "received 'free'"),
        (lambda: pf.stamens("tetradynamous", 8), "exactly 6; received 8"),
        (lambda: pf.stamens("diadelphous", 1), "at least 3"),
        (lambda: pf.pistils("double"), "received 'double'"),
        (lambda: pf.pistils("simple", 3), "exactly 1 carpel"),
        (lambda: pf.pistils("compound", 1), "2 carpels or more"),
        (lambda: pf.CompoundPistil(carpels=1), "2 carpels or more"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()
    assert set(PISTILS) == {"simple", "apocarpous", "compound"}
