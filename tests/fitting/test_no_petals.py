"""Stalks, tables, stamens and fused bases are no petals: petals are counted as if they were not there."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.segmentation import segments_of
from petalfit.fitting.segmentation.members import Sheet
from petalfit.fitting.siblings import Petal
from petalfit.fitting.thickets import without_thickets
from petalfit.results import Status, WarningKind
from petalfit.synthetic import read_flower_case

from .test_flower import NOISE, corolla, purity

CASES = Path(__file__).parents[2] / "data_synthetic" / "cases"


def stalk(count: int, bend: float, radius: float = 0.06, seed: int = 5) -> np.ndarray:
    """Points of a tube of length 1 below the origin; its lower end is `bend` aside."""
    rng = np.random.default_rng(seed)
    along, around = rng.uniform(0, 1, count), rng.uniform(0, 2 * math.pi, count)
    ring = radius * np.stack([np.cos(around), np.zeros(count), np.sin(around)], axis=-1)
    middle = np.stack([bend * along**2, -along, np.zeros(count)], axis=-1)
    return middle + ring + NOISE * rng.normal(size=(count, 3))


@pytest.mark.parametrize("bend", [0.0, 0.25])
@pytest.mark.parametrize("count", [400, 900])
def test_a_stalk_is_no_petal(count: int, bend: float) -> None:
    petals, truth = corolla(5)
    points = np.concatenate([petals, stalk(count, bend)])
    found = segments_of(points)
    assert found.count == 5
    assert purity(truth, found.labels[: len(petals)]) > 0.95
    on_stalk = np.arange(len(points)) >= len(petals)
    assert np.mean(found.labels[on_stalk] < 0) > 0.95
    assert np.mean(found.tubes[~on_stalk]) < 0.02
    assert not found.table.any()


def test_petals_that_stand_in_a_ring_are_no_tube() -> None:
    """The petals of a closed tulip lie on a tube, of which they are all that there is."""
    rng = np.random.default_rng(0)
    part, height = rng.uniform(-1, 1, (3, 700)), rng.uniform(0, 1.6, (3, 700))
    around = 2 * math.pi / 3 * (np.arange(3)[:, None] + 0.47 * part)
    bud = np.stack([0.4 * np.cos(around), height, 0.4 * np.sin(around)], axis=-1).reshape(-1, 3)
    found = segments_of(bud + NOISE * rng.normal(size=bud.shape))
    assert not found.tubes.any()
    assert np.mean(found.labels >= 0) > 0.95


@pytest.mark.parametrize("away", [0.1, 0.7])
def test_a_table_is_no_petal(away: float) -> None:
    petals, truth = corolla(5)
    rng = np.random.default_rng(3)
    flat = rng.uniform(-1.5, 1.5, (3000, 2))
    table = np.stack([flat[:, 0], np.full(3000, -away), flat[:, 1]], axis=-1)
    points = np.concatenate([petals, table + NOISE * rng.normal(size=table.shape)])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    found = segments_of(points @ turn)
    assert found.count == 5
    assert purity(truth, found.labels[: len(petals)]) > 0.9
    assert np.mean(found.table[len(petals) :]) > 0.95
    assert np.mean(found.table[: len(petals)]) < 0.02


def test_flat_leaves_of_a_rosette_are_no_table() -> None:
    petals, truth = corolla(5)
    petals[:, 1] = 0.05 * truth
    found = segments_of(petals + NOISE * np.random.default_rng(2).normal(size=petals.shape))
    assert found.count == 5
    assert not found.table.any()


@pytest.mark.parametrize("seed", range(3))
def test_fused_bases_are_shared_out(seed: int) -> None:
    _, (cloud, labels) = read_flower_case(CASES / "flower-lily")
    order = np.random.default_rng(seed).permutation(len(cloud))
    labels = labels[order]
    found = segments_of(cloud.points[order])
    assert found.count == 6
    assert purity(labels[labels >= 0], found.labels[labels >= 0]) > 0.88


def test_a_lily_on_a_table_has_six_petals_and_the_rest_is_named() -> None:
    _, (cloud, labels) = read_flower_case(CASES / "flower-lily-table")
    result = pf.fit_flower(cloud, throw=False)
    assert result.count == 6
    assert np.mean(result.labels[labels < 0] < 0) > 0.97
    (said,) = (warning for warning in result.warnings if warning.kind is WarningKind.LEFT_OUT)
    table, tubes = (
        float(part.split(" %")[0].split()[-1]) for part in said.text.split(": ")[1].split(";")
    )
    assert "as a table is" in said.text
    assert "as stalks and pistils are" in said.text
    assert 30 < table < 45
    assert 0 < tubes < 10


def test_only_misfits_in_a_thicket_are_left_out() -> None:
    rng = np.random.default_rng(0)
    sheets = [rng.uniform(0, 1, (300, 2)) @ np.eye(2, 3) + [3.0 * k, 0, 0] for k in range(4)]
    # The last two sheets lie among points of no sheet.
    strays = [rng.uniform([3.0 * k, 0, -0.1], [3.0 * k + 1, 1, 0.1], (200, 3)) for k in (2, 3)]
    seen = np.concatenate([*sheets, *strays])
    labels = np.concatenate([np.repeat(np.arange(4), 300), np.full(400, -1)])
    good = pf.fit_petal(pf.PeonyPetal().sample(200).points, throw=False)
    bad = dataclasses.replace(good, status=Status.MISFIT)
    nowhere = Sheet(np.zeros((1, 3)), np.zeros((1, 3)), 1.0)
    petals = [
        Petal(k, sheets[k], result, nowhere) for k, result in enumerate([good, bad, good, bad])
    ]
    kept = without_thickets(petals, seen, labels)
    assert [petal.segment for petal in kept] == [0, 1, 2]
    assert without_thickets(petals[3:], seen, labels) == petals[3:]
