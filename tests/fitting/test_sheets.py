"""Blades in an unknown pose: laid flat, fitted, and the same from wherever they come."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import petalfit as pf
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.families.blade.family import BladeFamily
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import Glimpse, looking_on
from petalfit.fitting.starts.flatten import flatten
from petalfit.residuals import Data

PETALS = Path(__file__).parents[3] / "shared" / "data" / "petals"
TRUTH = pf.BladePetal(
    width=0.6,
    widest=0.62,
    base_width=0.15,
    tip_width=0.35,
    tip_edge=0.05,
    tip_roll=0.8,
    skew=0.1,
    bend=0.9,
    bend_shift=-0.2,
    sickle=0.1,
    twist=0.2,
    cup_base=0.6,
    cup_mid=0.7,
    cup_tip=0.4,
    margin_curl=0.2,
)
NOISE = 0.03


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.linalg.det(q)


def test_a_rolled_sheet_is_laid_flat():
    """Distances in the plane are those along the sheet, however it is rolled and turned."""
    rng = np.random.default_rng(0)
    flat = rng.uniform([0, 0], [4, 2], (1500, 2))
    angle = flat[:, 0]  # four radians of a cylinder
    rolled = np.stack([np.sin(angle), flat[:, 1], 1 - np.cos(angle)], axis=-1) @ random_rotation(
        rng
    )
    plane = flatten(rolled)
    assert np.ptp(plane[:, 0]) == pytest.approx(4.0, rel=0.08)
    assert np.ptp(plane[:, 1]) == pytest.approx(2.0, rel=0.08)
    some = rng.choice(1500, (400, 2))
    own = np.linalg.norm(flat[some[:, 0]] - flat[some[:, 1]], axis=1)
    found = np.linalg.norm(plane[some[:, 0]] - plane[some[:, 1]], axis=1)
    assert np.corrcoef(own, found)[0, 1] > 0.99


def test_a_torn_sheet_is_laid_flat_too():
    rng = np.random.default_rng(1)
    flat = rng.uniform([0, 0], [4, 2], (1200, 2))
    flat = flat[np.abs(flat[:, 0] - 2) > 0.3]
    plane = flatten(np.column_stack([flat, np.zeros(len(flat))]))
    assert np.ptp(plane[:, 0]) == pytest.approx(4.0, rel=0.1)


@pytest.fixture(scope="module")
def posed():
    """A cloud of a blade somewhere, and what became of it while somebody looked on."""
    rng = np.random.default_rng(3)
    cloud = TRUTH.sample(768, seed=5, noise=NOISE)
    rotation, scale, shift = random_rotation(rng), 3.7, np.array([40.0, -20.0, 9.0])
    points = scale * cloud.points @ rotation.T + shift
    with looking_on(lambda _: None):
        result = pf.fit_petal(points, model=pf.BladePetal, pose="similarity")
    return points, pf.Pose(rotation, shift, scale), result


@pytest.fixture(scope="module")
def tipless():
    """A blade whose ends differ by little, what became of its cloud, and what was seen on the way."""
    like = {"widest": 0.5, "base_width": 0.3, "tip_width": 0.15, "tip_roll": 0.0}
    truth = dataclasses.replace(TRUTH, **like)
    rng = np.random.default_rng(3)
    points = 3.7 * truth.sample(768, seed=5, noise=NOISE).points @ random_rotation(rng).T
    seen: list[Glimpse] = []
    with looking_on(seen.append):
        result = pf.fit_petal(points, model=pf.BladePetal, pose="similarity")
    return truth, result, seen


def test_a_blade_is_shown_while_it_is_found(tipless):
    *_, seen = tipless
    assert len(seen) > 10
    assert len(seen[-1].points) == 768
    first, last = (np.std(glimpse.distances) for glimpse in (seen[0], seen[-1]))
    assert last < first


def test_a_blade_is_found_wherever_it_is(posed):
    _, pose, result = posed
    assert result.converged
    assert result.noise == pytest.approx(NOISE * pose.scale, rel=0.05)
    determined = [name for name in result.names if result.identifiable[name]]
    # How narrow ends are shaped moves hardly any point, so the data need not tell it.
    ends = {f"{end}_{what}" for end in ("base", "tip") for what in ("width", "taper", "edge")}
    assert set(determined) >= set(result.names) - ends
    for name in determined:
        error = abs(result.values[name] - getattr(TRUTH, name))
        assert error < 5 * result.stderr[name], name
    assert result.pose.scale == pytest.approx(pose.scale, rel=0.03)
    # The turn about x, which a bend near the base can replace, is known to two degrees only.
    turn = Rotation.from_matrix(pose.rotation.T @ np.asarray(result.pose.rotation)).as_rotvec()
    for axis, angle in zip("xyz", turn, strict=True):
        error = result.pose_stderr[f"turn_{axis}"]
        assert abs(angle) < 4 * error < np.radians(12), axis
    assert result.values["length"] == 10.0
    assert "length" not in result.names
    assert set(result.pose_stderr) == set(pf.components.Posed.similarity)


def test_a_blade_without_a_tip_says_that_either_end_may_be_it(tipless):
    """And one of the two is the truth, as far as the data tell."""
    truth, result, _ = tipless
    (rival,) = result.rivals
    assert rival.label == "base and tip exchanged"
    assert "almost as good: base and tip exchanged" in result.message

    def worst(values: Mapping[str, float]) -> float:
        known = [name for name in result.names if result.identifiable[name]]
        return max(abs(values[n] - getattr(truth, n)) / result.stderr[n] for n in known)

    assert min(worst(result.values), worst(rival.values)) < 5


def test_the_result_does_not_depend_on_frame_unit_and_order(posed):
    points, _, result = posed
    rng = np.random.default_rng(9)
    rotation, scale, shift = random_rotation(rng), 0.02, np.array([1.0, 2.0, -3.0])
    moved = (scale * points @ rotation.T + shift)[rng.permutation(len(points))]
    again = pf.fit_petal(moved, model=pf.BladePetal, pose="similarity")
    for name in result.names:
        assert again.values[name] == pytest.approx(result.values[name], abs=1e-6, rel=1e-6)
    composed = pf.Pose(rotation, shift, scale)
    with jax.enable_x64(True):
        expected = composed @ result.pose
    np.testing.assert_allclose(again.pose.rotation, expected.rotation, atol=1e-6)
    np.testing.assert_allclose(again.pose.translation, expected.translation, atol=1e-6)
    assert again.pose.scale == pytest.approx(float(expected.scale), rel=1e-6)


def test_the_result_survives_its_file_and_lies_in_the_targets_frame(posed, tmp_path):
    points, _, result = posed
    result.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json")
    assert again.values == result.values
    assert again.pose_stderr == result.pose_stderr
    gaps, _ = KDTree(np.asarray(result.mesh((65, 65)).vertices)).query(points)
    assert np.median(gaps) < 0.05 * np.ptp(points)


def test_a_blade_that_is_turned_over_says_the_same():
    """Foot points, signs of distances and errors belong to the numbers that are reported."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(6)
        names = ("width", "bend", "cup_mid", "keel", "twist", *pf.components.Posed.similarity)
        hollow = TRUTH.turned_over()
        model = pf.components.Posed(hollow, random_rotation(rng), np.array([1.0, 2.0, 3.0]), 0.4)
        uv = np.stack([rng.uniform(-0.45, 0.45, 96), rng.uniform(0.05, 0.95, 96)], axis=-1)
        points = np.asarray(model(*uv.T)) + 0.01 * rng.standard_normal((96, 3))
        cloud = ObservedCloud(Data.of(points, np.ones(96), 0.01))

        def end(model: pf.components.Posed, uv: np.ndarray) -> Iterate:
            coordinates = Coordinates.of(model, names)
            t, term = coordinates.inverse(model), cloud.at(uv)
            slopes = coordinates.slopes(t)
            information = cloud.information(coordinates, t, term)[0] / np.outer(slopes, slopes)
            return Iterate(
                model,
                (term,),
                1,
                0.0,
                information=information,
                score_covariance=information,
                residuals=tuple(cloud.residuals(coordinates, t, term)),
            )

        mapped = BladeFamily().standard_form(end(model, uv), names)
        assert float(mapped.model.surface.cup_mid) == pytest.approx(TRUTH.cup_mid)
        (seen,) = mapped.residuals
        again = end(mapped.model, seen.uv)
        np.testing.assert_allclose(mapped.model(*seen.uv.T), model(*uv.T), atol=1e-9)
        np.testing.assert_allclose(again.residuals[0].distance, seen.distance, atol=1e-9)
        shape = np.s_[:5, :5]
        np.testing.assert_allclose(
            np.linalg.inv(again.information)[shape],
            np.linalg.inv(mapped.information)[shape],
            rtol=1e-6,
            atol=1e-12,
        )


@pytest.mark.skipif(not PETALS.exists(), reason="third-party petals are not in the project")
@pytest.mark.parametrize("name", ["lily0_tepal1", "tulip_rosaLjus_petal1"])
def test_a_petal_that_nobody_generated(name):
    """Both ways below 0.7 % of the diagonal; measured on dense samples."""
    cloud = pf.PointCloud.load(PETALS / f"{name}.ply", n=768)
    result = pf.fit_petal(cloud, model=pf.BladePetal, pose="similarity", throw=False)
    dense = pf.PointCloud.load(PETALS / f"{name}.ply", n=60_000, seed=1).points
    surface = pf.PointCloud.from_mesh(result.mesh((97, 97)), n=60_000).points
    there, _ = KDTree(surface).query(dense[:5000])
    back, _ = KDTree(dense).query(surface[:5000])
    assert 100 * max(there.mean(), back.mean()) / cloud.diagonal < 0.7


def test_the_best_family_is_picked_and_says_by_how_much(posed, tmp_path):
    points, _, blade = posed
    result = pf.fit_petal(points, model="auto", pose="similarity")
    first, second, third = result.ranking
    assert (first.model, second.model, third.model) == ("BladePetal", "SplinePetal", "PeonyPetal")
    assert result.values == blade.values
    assert 0 == first.delta_bic < second.delta_bic < third.delta_bic
    assert f"SplinePetal is worse by {second.delta_bic:.0f} in BIC" in result.message
    # Less than all 300 coefficients, and more than a blade has parameters.
    assert first.freedom == 26 < second.freedom < 200
    result.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json")
    assert (again.ranking, again.freedom) == (result.ranking, result.freedom)
    result.report(tmp_path / "report.html")
    assert "numbers it may choose" in (tmp_path / "report.html").read_text()


def test_what_has_no_pose_is_refused():
    cloud = TRUTH.sample(300)
    with pytest.raises(pf.TargetError, match="is there for PeonyPetal, BladePetal"):
        pf.fit(pf.Ellipsoid, cloud, pose="rigid")
    with pytest.raises(ValueError, match="must be 'known', 'rigid' or 'similarity'"):
        pf.fit_petal(cloud, pose="free")
    with pytest.raises(pf.TargetError, match="one cloud"):
        pf.fit_petal([cloud, cloud], model=pf.BladePetal, pose="rigid")
    with pytest.raises(pf.TargetError, match="no pose to start from"):
        pf.fit_petal(cloud, model=pf.BladePetal, pose="rigid", init=TRUTH)


def test_a_spline_has_the_sum_of_its_basis():
    """Against SciPy's B-splines; and a linear field of coefficients is a plane."""
    from scipy.interpolate import BSpline

    from petalfit.components.spline_petal import SEGMENTS

    rng = np.random.default_rng(0)
    offsets = rng.standard_normal((SEGMENTS[0] + 3, SEGMENTS[1] + 3, 3))
    petal = pf.SplinePetal(a_x=3.0, b_y=5.0, offsets=offsets)
    u, v = rng.uniform(-0.5, 0.5, 50), rng.uniform(0, 1, 50)
    knots = [np.arange(-3, n + 4) / n for n in SEGMENTS]
    across, along = (
        BSpline(k, np.eye(n + 3), 3)(x)
        for k, n, x in zip(knots, SEGMENTS, (u + 0.5, v), strict=True)
    )
    expected = np.einsum("nk,nm,kmd->nd", across, along, offsets)
    expected += np.stack([3 * u, 5 * v, np.zeros(50)], axis=-1)
    with jax.enable_x64(True):
        np.testing.assert_allclose(petal(u, v), expected, atol=1e-12)


# Blades as wide as long: the axes of their flattened clouds need not be those of midrib and sides.
ROUND = [
    pf.BladePetal(
        **{"width": 1.03, "widest": 0.41, "base_width": 0.33, "tip_width": 0.45},
        **{"base_taper": 0.98, "tip_taper": 0.68, "tip_edge": 0.02, "base_edge": 0.1},
        **{"skew": -0.17, "bend": -0.25, "bend_shift": 0.16, "tip_roll": 0.48, "sickle": 0.23},
        **{"twist": -0.21, "cup_base": 0.22, "cup_mid": 0.84, "cup_tip": -0.8},
        **{"margin_curl": 0.35, "keel": -0.06},
    ),
    pf.BladePetal(
        **{"width": 1.06, "widest": 0.27, "base_width": 0.34, "tip_width": 0.52},
        **{"base_taper": 0.54, "tip_taper": 1.17, "tip_edge": 0.19, "base_edge": 0.09},
        **{"skew": -0.27, "bend": -1.19, "bend_shift": 0.29, "tip_roll": 0.39, "sickle": -0.21},
        **{"twist": 0.28, "cup_base": -0.56, "cup_mid": 0.08, "cup_tip": 0.53},
        **{"margin_curl": -0.38, "keel": -0.01},
    ),
]


@pytest.mark.parametrize("blade", ROUND)
def test_a_round_blade_is_found_whichever_way_its_axes_lie(blade):
    points = blade.sample(1500, seed=6, noise=0.02).points
    points = points @ random_rotation(np.random.default_rng(6)).T
    result = pf.fit_petal(points, model=pf.BladePetal, pose="similarity")
    assert result.rms < 0.022
    assert result.values["width"] == pytest.approx(blade.width, rel=0.02)
    assert abs(result.values["skew"]) == pytest.approx(abs(blade.skew), abs=0.05)


def test_a_spline_follows_a_sheet_wherever_it_is(tmp_path):
    rng = np.random.default_rng(4)
    cloud = TRUTH.sample(2000, seed=5, noise=0.01)
    rotation = random_rotation(rng)
    points = 0.3 * cloud.points @ rotation.T + [5.0, 6.0, 7.0]
    result = pf.fit_petal(points, model=pf.SplinePetal, pose="similarity")
    assert result.rms < 0.3 * 0.03
    assert result.values["b_y"] == pytest.approx(10.0)
    back, _ = KDTree(np.asarray(TRUTH.mesh((129, 129)).vertices)).query(
        (result.mesh((65, 65)).vertices - [5.0, 6.0, 7.0]) @ rotation / 0.3
    )
    assert back.mean() < 0.06
    result.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.model.offsets, result.model.offsets)
    moved = points[rng.permutation(2000)] @ random_rotation(rng).T * 40
    other = pf.fit_petal(moved, model=pf.SplinePetal, pose="similarity")
    np.testing.assert_allclose(other.model.offsets, result.model.offsets, atol=1e-6)
    assert other.values["a_x"] == pytest.approx(result.values["a_x"], rel=1e-6)
    rigid = pf.fit_petal(points, model=pf.SplinePetal, pose="rigid")
    assert rigid.pose.scale == 1.0
    assert rigid.rms == pytest.approx(result.rms, rel=1e-3)
    assert rigid.values["a_x"] == pytest.approx(result.values["a_x"] * result.pose.scale, rel=1e-6)
    known = pf.fit_petal(points, model=pf.SplinePetal)
    assert known.rms == pytest.approx(result.rms, rel=1e-3)
    assert known.pose == pf.Pose.identity() or known.pose.scale == 1.0
    with pytest.raises(pf.TargetError, match="too few for a SplinePetal"):
        pf.fit_petal(points[:50], model=pf.SplinePetal)


@pytest.mark.skipif(not PETALS.exists(), reason="third-party petals are not in the project")
def test_a_spline_follows_a_rolled_rose_petal():
    cloud = pf.PointCloud.load(PETALS / "rose1_petal13.ply", n=2000)
    result = pf.fit_petal(cloud, model=pf.SplinePetal, pose="similarity")
    dense = pf.PointCloud.load(PETALS / "rose1_petal13.ply", n=200_000, seed=1).points
    surface = pf.PointCloud.from_mesh(result.mesh((97, 97)), n=200_000).points
    there, _ = KDTree(surface).query(dense[:5000])
    back, _ = KDTree(dense).query(surface[:5000])
    assert 100 * max(there.mean(), back.mean()) / cloud.diagonal < 0.2
