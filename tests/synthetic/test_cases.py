"""The committed cases are what their manifest says, can be made again, and can be read."""

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from petalfit.components import parameters
from petalfit.flowers import load_flower
from petalfit.synthetic import (
    FLOWERS,
    RECIPES,
    Case,
    FlowerCase,
    check_cases,
    make,
    make_masks,
    random_petal,
    read_case,
    read_flower_case,
    scan,
    write_cases,
)
from petalfit.synthetic.random_petal import RANGES

FOLDER = Path(__file__).parents[2] / "data_synthetic"
NAMES = [case.name for case in RECIPES]


def values(case: Case) -> dict[str, float]:
    return {name: float(value) for name, value in vars(case.model).items()}


def test_files_are_the_manifests_and_come_out_the_same_again() -> None:
    assert check_cases(FOLDER) == []
    assert sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()) < 1_500_000


def test_manifest_tells_all() -> None:
    entries = json.loads((FOLDER / "manifest.json").read_text(encoding="utf-8"))["cases"]
    assert [entry["name"] for entry in entries] == NAMES
    for entry, case in zip(entries, RECIPES, strict=True):
        assert entry["parameters"] == values(case)
        assert (entry["noise"], entry["seed"], entry["points"], entry["strays"]) == (
            case.noise, case.seed, case.points, case.strays
        )  # fmt: skip
        assert len(entry["files"]) == 1 + (case.points > 0) + 2 * len(case.sights)


@pytest.mark.parametrize("recipe", RECIPES, ids=NAMES)
def test_case_reads_back(recipe: Case) -> None:
    case, targets = read_case(FOLDER / "cases" / recipe.name)
    assert values(case) == values(recipe)
    assert dataclasses.replace(case, model=recipe.model) == recipe
    masks = targets[recipe.points > 0 :]
    for mask, made in zip(masks, make_masks(recipe), strict=True):
        np.testing.assert_allclose(mask.mask, made.mask, atol=0.5 / 255)
        np.testing.assert_allclose(mask.camera.matrix, made.camera.matrix)
    if not recipe.points:
        return
    cloud = targets[0]
    assert len(cloud) == recipe.points
    assert cloud.normals is None
    if recipe.keep is not None:
        normal, offset = recipe.keep
        assert (cloud.points @ np.array(normal)).min() > offset - 6 * recipe.noise


@pytest.mark.parametrize("recipe", RECIPES, ids=NAMES)
def test_truth_is_inside_the_typical_ranges(recipe: Case) -> None:
    for name, parameter in parameters(recipe.model).items():
        low, high = parameter.typical
        assert low <= float(getattr(recipe.model, name)) <= high, name


def test_noise_and_strays_are_as_declared() -> None:
    # The same seed gives the same points of the surface, so differences are the noise alone.
    recipe = next(case for case in RECIPES if case.name == "outliers")
    clean = make(dataclasses.replace(recipe, noise=0.0)).points
    noisy = make(recipe).points
    true = slice(recipe.points - recipe.strays)
    difference = noisy[true] - clean[true]
    assert abs(difference.std() / recipe.noise - 1) < 0.05
    assert abs(difference.mean()) < 4 * recipe.noise / np.sqrt(difference.size)
    farther = np.linalg.norm(noisy[:, None] - clean[None, true], axis=-1).min(axis=1)
    assert np.median(farther[recipe.points - recipe.strays :]) > 20 * recipe.noise
    assert farther[true].max() < 6 * recipe.noise


def test_check_finds_what_is_wrong(tmp_path: Path) -> None:
    tiny = dataclasses.replace(RECIPES[0], points=60)
    other = dataclasses.replace(tiny, name="other", suffix=".npz")
    written = write_cases(tmp_path, [tiny, other], [])
    assert check_cases(tmp_path, [tiny, other], []) == []
    cloud = tmp_path / "cases/other/cloud.npz"
    content = cloud.read_bytes()
    cloud.write_bytes(content[:-1] + b"!")
    assert check_cases(tmp_path, [tiny, other], []) == [
        "cases/other/cloud.npz is not what the manifest says",
        "cases/other/cloud.npz comes out different when it is made again",
    ]
    cloud.unlink()
    (tmp_path / "cases/other/more.txt").touch()
    assert check_cases(tmp_path, [tiny, other], []) == [
        "cases/other/cloud.npz is missing",
        "cases/other/more.txt is not in the manifest",
    ]
    assert written[-1].name == "manifest.json"


def test_only_strays_is_refused() -> None:
    with pytest.raises(ValueError, match="60 strays of 60 points"):
        dataclasses.replace(RECIPES[0], points=60, strays=60)


def test_random_petals_fill_their_ranges() -> None:
    rng = np.random.default_rng(5)
    petals = [random_petal(rng) for _ in range(400)]
    for name, (low, high) in RANGES.items():
        drawn = np.array([float(getattr(petal, name)) for petal in petals])
        size = np.abs(drawn) if name == "dx" else drawn
        assert low <= size.min() < low + 0.05 * (high - low), name
        assert high >= size.max() > high - 0.05 * (high - low), name
    assert abs(np.mean([float(petal.dx) > 0 for petal in petals]) - 0.5) < 0.1
    again = random_petal(np.random.default_rng(5))
    assert again == petals[0]


@pytest.mark.parametrize("recipe", FLOWERS, ids=[case.name for case in FLOWERS])
def test_flower_reads_back_and_lies_on_its_surfaces(recipe: FlowerCase) -> None:
    folder = FOLDER / "cases" / recipe.name
    case, (cloud, labels) = read_flower_case(folder)
    assert case == recipe
    assert len(cloud) == len(labels) == recipe.points
    flower = load_flower(folder / "flower.json")
    series = next(series for series in flower.series if series.name == "petal")
    own = cloud.points @ Rotation.from_rotvec(recipe.turn).as_matrix()
    (part,) = (part for part in flower.parts() if part.series == flower.series.index(series))
    for number in range(len(series)):
        surface, inner, outer = jax.tree.map(
            lambda leaf, number=number: leaf[number], (part.surface, part.inner, part.outer)
        )
        fine = np.asarray((outer @ inner)(np.asarray(surface.mesh((193, 97)).vertices)))
        away, _ = KDTree(fine).query(own[labels == number])
        # Noise along the normal, and the way to the nearest vertex.
        assert np.median(away) < 0.35
        assert away.max() < 1.0
    # Every petal is seen somewhere, and so are other organs.
    assert {-1, *range(len(series))} == set(labels.tolist())


def test_a_scanner_sees_the_nearest_sheet_only() -> None:
    one = dataclasses.replace(FLOWERS[0], points=2000, noise=0.0, views=((0.0, 0.0, 1.0),))
    other = dataclasses.replace(one, views=((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)))
    turned = Rotation.from_rotvec(one.turn).as_matrix()
    front = scan(one).cloud.points @ turned
    both = scan(other).cloud.points @ turned
    # In a narrow column the points of one view lie at nearly one depth, those of two often at two.
    depths = []
    for points in (front, both):
        near = KDTree(points[:, :2]).query(points[:, :2], 6)[1]
        depths.append(np.median(np.ptp(points[near, 2], axis=1)))
    assert depths[0] < 0.35 * depths[1]


def test_a_table_lies_below_its_flower() -> None:
    recipe = next(case for case in FLOWERS if case.table)
    cloud, labels = scan(dataclasses.replace(recipe, noise=0.0))
    own = cloud.points @ Rotation.from_rotvec(recipe.turn).as_matrix()
    level = np.abs(own[:, 1] - own[:, 1].min()) < 1e-3
    assert np.mean(level) > 0.25
    assert np.all(labels[level] == -1)
