import dataclasses
import math
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from petalfit.observations import PointCloud, TargetError, as_point_cloud

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
SQUARE = trimesh.Trimesh(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
)

seeds = st.integers(0, 2**32 - 1)
units = st.integers(-60, 60).map(lambda exponent: 10.0**exponent)


def strip(rng: np.random.Generator, n: int = 40, width: float = 0.3) -> np.ndarray:
    """Points about a segment of length 2 in a random direction."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    along = np.concatenate([[-1.0, 1.0], rng.uniform(-1.0, 1.0, n - 2)])
    return along[:, None] * direction + width * rng.uniform(-1.0, 1.0, (n, 3))


class TestArrays:
    @pytest.mark.parametrize("kind", [np.float32, np.float16, np.int64, np.uint8, np.longdouble])
    def test_numbers_become_float64(self, kind):
        cloud = PointCloud(TETRAHEDRON.astype(kind))
        assert cloud.points.dtype == np.float64
        np.testing.assert_array_equal(cloud.points, TETRAHEDRON)
        assert len(cloud) == 4

    def test_arrays_are_read_only_copies(self):
        mine = [TETRAHEDRON.copy(), TETRAHEDRON + 1.0, np.ones(4)]
        cloud = PointCloud(*mine)
        for array, name in zip(mine, ("points", "normals", "weights"), strict=True):
            before = getattr(cloud, name).copy()
            array[:] = 7.0
            np.testing.assert_array_equal(getattr(cloud, name), before)
            with pytest.raises(ValueError, match="read-only"):
                getattr(cloud, name)[0] = 0.0
        with pytest.raises(dataclasses.FrozenInstanceError):
            cloud.points = TETRAHEDRON

    def test_repr_is_short(self):
        assert repr(PointCloud(TETRAHEDRON)) == "PointCloud(4 points, extent 1 × 1 × 1)"
        assert repr(PointCloud(TETRAHEDRON, TETRAHEDRON + 1.0, np.ones(4))).endswith(
            ", normals, weights)"
        )

    @pytest.mark.parametrize(
        ("points", "message"),
        [
            (np.zeros((0, 3)), r"points are empty \(shape \(0, 3\)\)"),
            ([], r"points are empty"),
            (np.ones((3, 500)), r"shape \(3, 500\), expected \(N, 3\); transpose them: points.T"),
            (np.ones((500, 2)), r"shape \(500, 2\).*three coordinates, so add the missing column"),
            (np.ones((500, 6)), r"shape \(500, 6\).*keep the coordinates only: points\[:, :3\]"),
            (np.ones(500), r"shape \(500,\).*one row of x, y, z for each point"),
            (np.ones((5, 1)), r"shape \(5, 1\).*one row of x, y, z for each point"),
            (np.ones((4, 4, 3)), r"shape \(4, 4, 3\).*one row of x, y, z for each point"),
            (np.float64(3.0), r"shape \(\), expected \(N, 3\)"),
            ([[0, 0, 0], [1, 2]], r"cannot be made an array .* a rectangular array of numbers"),
            (TETRAHEDRON.astype(str), r"points have the type <U32.*\.astype\(float\)"),
            (TETRAHEDRON.astype(object), r"points have the type object"),
            (TETRAHEDRON.astype(complex), r"points have the type complex128"),
            (TETRAHEDRON.astype(bool), r"points have the type bool"),
        ],
    )
    def test_what_is_no_array_of_points_is_refused(self, points, message):
        with pytest.raises(TargetError, match=message):
            PointCloud(points)

    @given(
        seed=seeds,
        bad=st.dictionaries(
            st.integers(0, 39), st.sampled_from([math.nan, math.inf, -math.inf]), min_size=1
        ),
    )
    def test_what_is_not_finite_is_counted(self, seed, bad):
        rng = np.random.default_rng(seed)
        points = strip(rng)
        for row, value in bad.items():
            points[row, rng.integers(3)] = value
        message = rf"{len(bad)} of 40 points .*, the first in row {min(bad)}; drop them: points\["
        with pytest.raises(TargetError, match=message):
            PointCloud(points)

    def test_masked_points_are_not_revealed(self):
        points = np.ma.MaskedArray(TETRAHEDRON, mask=False)
        np.testing.assert_array_equal(PointCloud(points).points, TETRAHEDRON)
        points[2, 1] = np.ma.masked
        with pytest.raises(TargetError, match=r"1 of 4 points .* the first in row 2"):
            PointCloud(points)

    def test_coordinates_whose_squares_overflow_are_refused(self):
        with pytest.raises(TargetError, match=r"up to 1e\+200, expected at most 1e\+150"):
            PointCloud(TETRAHEDRON * 1e200)


class TestSpread:
    @given(seed=seeds, unit=units, shift=st.floats(-1e6, 1e6))
    def test_validity_knows_no_order_unit_or_offset(self, seed, unit, shift):
        rng = np.random.default_rng(seed)
        points = strip(rng)
        moved = rng.permutation(points + shift * rng.uniform(-1.0, 1.0, 3)) * unit
        assert len(PointCloud(moved)) == len(points)

    @given(seed=seeds, unit=units, shift=st.floats(-1e8, 1e8))
    def test_collinear_points_are_refused_in_any_order_unit_and_offset(self, seed, unit, shift):
        rng = np.random.default_rng(seed)
        line = strip(rng, width=0.0)
        moved = rng.permutation(line + shift * rng.uniform(-1.0, 1.0, 3)) * unit
        with pytest.raises(TargetError, match=r"on one line \(40 of them\); at least three that"):
            PointCloud(moved)

    def test_collinear_points_in_single_precision_are_refused(self):
        line = strip(np.random.default_rng(0), width=0.0).astype(np.float32)
        with pytest.raises(TargetError, match="on one line"):
            PointCloud(line)

    @pytest.mark.parametrize("width", [1e-5, 1e-4, 1e-2])
    def test_a_thin_noisy_strip_is_a_cloud(self, width):
        PointCloud(strip(np.random.default_rng(0), n=5000, width=width))

    def test_one_point_off_a_long_line_is_enough(self):
        line = strip(np.random.default_rng(0), n=100_000, width=0.0)
        line[0] += [3e-4, -2e-4, 1e-4]
        PointCloud(line)

    def test_flat_points_are_a_cloud(self):
        PointCloud(TETRAHEDRON[:3])

    @pytest.mark.parametrize("n", [1, 2, 50])
    @pytest.mark.parametrize("place", [0.0, 0.1, 5e6])
    def test_coincident_points_are_refused(self, n, place):
        message = rf"all coincide \({n} at \[{place}, {place}, {place}\]\); at least three"
        with pytest.raises(TargetError, match=message):
            PointCloud(np.full((n, 3), place))

    def test_two_points_are_a_line(self):
        with pytest.raises(TargetError, match=r"on one line \(2 of them\)"):
            PointCloud(TETRAHEDRON[:2])

    def test_a_far_offset_is_legal_as_far_as_it_is_resolved(self):
        utm = np.array([691_603.0, 5_334_784.0, 520.0])
        assert len(PointCloud(0.2 * TETRAHEDRON + utm)) == 4
        with pytest.raises(TargetError, match=r"span only 0.001 at .* 5334784, .*subtract a comm"):
            PointCloud(0.001 * TETRAHEDRON + utm)

    def test_ignored_points_make_no_spread(self):
        weights = np.array([1.0, 1.0, 0.0, 0.0])
        with pytest.raises(TargetError, match=r"on one line \(2 of them\)"):
            PointCloud(TETRAHEDRON, weights=weights)


class TestNormals:
    @given(seed=seeds, unit=st.sampled_from([1e-250, 1e-3, 1.0, 1e200]))
    def test_are_brought_to_unit_length(self, seed, unit):
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=(4, 3))
        normals = PointCloud(TETRAHEDRON, direction * unit).normals
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=4e-16)
        expected = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        np.testing.assert_allclose(normals, expected, rtol=1e-15)

    @given(seed=seeds)
    def test_of_unit_length_are_kept_to_the_last_bit(self, seed):
        rng = np.random.default_rng(seed)
        once = PointCloud(TETRAHEDRON, rng.normal(size=(4, 3))).normals
        np.testing.assert_array_equal(PointCloud(TETRAHEDRON, once).normals, once)

    @pytest.mark.parametrize(
        ("normals", "message"),
        [
            (np.ones((3, 3)), r"normals have shape \(3, 3\), expected \(4, 3\), one for each"),
            (np.ones((4, 2)), r"normals have shape \(4, 2\), expected \(4, 3\)"),
            (TETRAHEDRON, r"1 of 4 normals have zero length, the first in row 0; drop those"),
            (TETRAHEDRON / [1, 1, 0.5] + [0, 0, math.nan], "4 of 4 normals have a NaN"),
            (TETRAHEDRON.astype(str), "normals have the type <U32"),
        ],
    )
    def test_that_cannot_be_used_are_refused(self, normals, message):
        with pytest.raises(TargetError, match=message):
            PointCloud(TETRAHEDRON, normals=normals)


class TestWeights:
    def test_are_kept_as_they_are(self):
        weights = np.array([0.0, 3.0, 1e-3, 2.0])
        np.testing.assert_array_equal(PointCloud(TETRAHEDRON, weights=weights).weights, weights)

    @pytest.mark.parametrize(
        ("weights", "message"),
        [
            (np.ones(3), r"weights have shape \(3,\), expected \(4,\), one for each point"),
            (np.ones((4, 1)), r"weights have shape \(4, 1\), expected \(4,\)"),
            (np.array([1, 1, -2, 1]), "1 of 4 weights are negative, the first in row 2; use 0"),
            (np.array([1, math.nan, 1, math.inf]), "2 of 4 weights are NaN.*first in row 1; use 0"),
            (np.zeros(4), "weights are all zero, expected at least one that is positive"),
            (np.array(["1"] * 4), "weights have the type <U1"),
        ],
    )
    def test_that_cannot_be_used_are_refused(self, weights, message):
        with pytest.raises(TargetError, match=message):
            PointCloud(TETRAHEDRON, weights=weights)


class TestMeasures:
    def test_of_a_box(self):
        cloud = PointCloud(TETRAHEDRON * [1.0, 2.0, 2.0] - 7.0)
        np.testing.assert_array_equal(cloud.extent, [1.0, 2.0, 2.0])
        assert cloud.diagonal == 3.0
        np.testing.assert_allclose(cloud.centroid, np.array([0.25, 0.5, 0.5]) - 7.0, rtol=1e-15)

    @given(seed=seeds, unit=units)
    def test_diagonal_scales_with_the_unit(self, seed, unit):
        points = strip(np.random.default_rng(seed))
        ratio = PointCloud(points * unit).diagonal / PointCloud(points).diagonal
        assert ratio == pytest.approx(unit, rel=1e-14)

    @pytest.mark.parametrize("weighted", [False, True])
    def test_centroid_is_exact_far_from_the_origin(self, weighted):
        rng = np.random.default_rng(1)
        points = rng.uniform(0.0, 0.1, (20_000, 3)) + 5e6
        weights = rng.uniform(0.0, 1e300, len(points)) if weighted else None
        cloud = PointCloud(points, weights=weights)
        factors = np.ones(len(points)) if weights is None else weights / 1e300
        total = math.fsum(factors)
        exact = [math.fsum(factors * column) / total for column in points.T]
        np.testing.assert_allclose(cloud.centroid, exact, rtol=0.0, atol=2e-9)


class TestFromMesh:
    def test_points_lie_on_the_faces_with_their_normals(self):
        mesh = trimesh.creation.box((1.0, 2.0, 3.0))
        cloud = PointCloud.from_mesh(mesh, 500, seed=1)
        assert len(cloud) == 500
        side = np.abs(cloud.points) / [0.5, 1.0, 1.5]
        face = side.argmax(axis=1)
        np.testing.assert_allclose(side.max(axis=1), 1.0, rtol=1e-14)
        outward = np.eye(3)[face] * np.sign(cloud.points)
        np.testing.assert_allclose(cloud.normals, outward, atol=1e-14)

    def test_a_seed_says_which_points(self):
        first, again, other = (PointCloud.from_mesh(SQUARE, 50, seed).points for seed in (3, 3, 4))
        np.testing.assert_array_equal(first, again)
        assert np.abs(first - other).max() > 0.1

    def test_is_uniform_by_area(self):
        # 16 cells of equal area, cut by the edges of triangles of very different sizes.
        x = np.array([0.0, 0.07, 0.4, 1.0])
        corners = np.array([[[a, 0.0, 0.0], [a, 1.0, 0.0]] for a in x]).reshape(-1, 3)
        strips = [[i, i + 2, i + 3] for i in (0, 2, 4)] + [[i, i + 3, i + 1] for i in (0, 2, 4)]
        n = 40_000
        points = PointCloud.from_mesh(trimesh.Trimesh(corners, strips), n, seed=5).points
        counts = np.histogram2d(points[:, 0], points[:, 1], bins=4, range=[[0, 1], [0, 1]])[0]
        chi_squared = ((counts - n / 16) ** 2 / (n / 16)).sum()
        assert counts.sum() == n
        assert 3.5 < chi_squared < 38.0  # 15 degrees of freedom: P < 0.001 on either side.

    @pytest.mark.parametrize("unit", [1e-120, 1e-9, 1e100])
    def test_knows_no_unit(self, unit):
        scaled = trimesh.Trimesh(SQUARE.vertices * unit, SQUARE.faces, process=False)
        cloud, plain = PointCloud.from_mesh(scaled, 50), PointCloud.from_mesh(SQUARE, 50)
        np.testing.assert_allclose(cloud.points / unit, plain.points, rtol=1e-12)
        np.testing.assert_array_equal(cloud.normals, plain.normals)

    def test_faces_without_area_get_no_points(self):
        faces = [[0, 0, 0], [0, 1, 2], [0, 1, 1]]
        cloud = PointCloud.from_mesh(trimesh.Trimesh(SQUARE.vertices, faces, process=False), 200)
        assert (cloud.points[:, 1] <= cloud.points[:, 0]).all()

    @pytest.mark.parametrize(
        ("vertices", "faces", "message"),
        [
            (SQUARE.vertices, [], "no faces; if it is a cloud, give its vertices"),
            (SQUARE.vertices, [[0, 1, 4]], "use vertices 0 to 4, but its vertices are 0 to 3"),
            (SQUARE.vertices, [[0, 1, -1]], "use vertices -1 to 1, but"),
            (SQUARE.vertices, [[0, 0, 0]], "no area: the corners of every face coincide"),
            (SQUARE.vertices, [[0, 1, 1]], "no area: every face is a line or a point"),
            (SQUARE.vertices[:, :2], [[0, 1, 2]], r"vertices of shape \(4, 2\) and faces of"),
            (SQUARE.vertices * math.nan, [[0, 1, 2]], "NaN.* in 1 of 1 faces, .* is face 0; rem"),
            (SQUARE.vertices * 1e200, [[0, 1, 2], [0, 2, 3]], r"beyond 1e\+150 in 2 of 2 faces"),
        ],
    )
    def test_meshes_that_cannot_be_used_are_refused(self, vertices, faces, message):
        mesh = trimesh.Trimesh(vertices, np.reshape(faces, (-1, 3)).astype(int), process=False)
        with pytest.raises(TargetError, match=message):
            PointCloud.from_mesh(mesh, 10)

    @pytest.mark.parametrize("n", [0, -3])
    def test_there_must_be_points_to_draw(self, n):
        with pytest.raises(ValueError, match=f"n is {n}, expected a positive number"):
            PointCloud.from_mesh(SQUARE, n)


class TestAsPointCloud:
    @pytest.mark.parametrize(
        "target",
        [
            TETRAHEDRON,
            TETRAHEDRON.tolist(),
            tuple(map(tuple, TETRAHEDRON)),
            jnp.asarray(TETRAHEDRON),
            trimesh.PointCloud(TETRAHEDRON),
            trimesh.Trimesh(TETRAHEDRON),
            trimesh.Scene(trimesh.PointCloud(TETRAHEDRON)),
        ],
        ids=["numpy", "list", "tuple", "jax", "trimesh cloud", "faceless mesh", "cloud in a scene"],
    )
    def test_takes_points_as_they_are(self, target):
        cloud = as_point_cloud(target)
        np.testing.assert_array_equal(cloud.points, TETRAHEDRON)
        assert cloud.normals is None

    def test_returns_a_cloud_itself(self):
        cloud = PointCloud(TETRAHEDRON)
        assert as_point_cloud(cloud) is cloud

    def test_samples_meshes(self):
        np.testing.assert_array_equal(
            as_point_cloud(SQUARE).points, PointCloud.from_mesh(SQUARE).points
        )

    def test_samples_a_scene_where_its_nodes_are(self):
        scene = trimesh.Scene()
        scene.add_geometry(SQUARE)
        scene.add_geometry(SQUARE, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
        scene.add_geometry(trimesh.PointCloud(TETRAHEDRON + 50.0))
        x = as_point_cloud(scene).points[:, 0]
        assert ((x <= 1.0) | ((x >= 5.0) & (x <= 6.0))).all()
        assert abs((x > 1.0).mean() - 0.5) < 4.0 * 0.5 / math.sqrt(len(x))

    @pytest.mark.parametrize("kind", [str, lambda path: path])
    def test_reads_paths(self, kind, tmp_path):
        path = tmp_path / "cloud.npy"
        np.save(path, TETRAHEDRON)
        np.testing.assert_array_equal(as_point_cloud(kind(path)).points, TETRAHEDRON)

    @pytest.mark.parametrize("target", [None, 3, b"scan.ply", {"points": 1}, {1.0}, iter([])])
    def test_refuses_what_is_no_cloud(self, target):
        message = rf"type {type(target).__name__} is not.*array, a PointCloud, a trimesh.*path of"
        with pytest.raises(TargetError, match=message):
            as_point_cloud(target)

    @pytest.mark.parametrize("geometry", [trimesh.Scene(), trimesh.Trimesh()])
    def test_refuses_what_is_empty(self, geometry):
        with pytest.raises(TargetError, match="there are no vertices; give a mesh or a cloud"):
            as_point_cloud(geometry)


def test_import_and_array_targets_are_light():
    program = """
import sys
from petalfit.observations import as_point_cloud
as_point_cloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
print({"jax", "trimesh", "scipy"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "set()\n", done.stderr
