"""Formats of scanners and surveys, and what each file that was once misread is read as."""

import io
import struct
import sys

import numpy as np
import pytest
import trimesh
from formats import e57_of, las_of, pcd_of, ply_of, text_of

from petalfit.observations import PointCloud, TargetError
from petalfit.observations.columns import understood, unnamed_columns
from petalfit.observations.sheets import sheet_notes

POINTS = np.random.default_rng(0).normal(size=(40, 3))
SINGLE = POINTS.astype(np.float32)


def saved(array: np.ndarray) -> bytes:
    """The content of an .npy file."""
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


@pytest.fixture
def load(tmp_path):
    def read(name, content):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return PointCloud.load(path, n=500)

    return read


class TestNames:
    @pytest.mark.parametrize(
        "names",
        [
            ["point", "x [mm]", "y [mm]", "z [mm]"],
            ["scalars", "Points:0", "Points:1", "Points:2"],
            ['"a"', '"Points_0"', '"Points_1"', '"Points_2"'],
            ["", "X", "Y", "Z"],
            ["id", "x_mm", "y_mm", "z_mm"],
            ["t", "coord_x", "coord_y", "coord_z"],
            ["t", "pos.x", "pos.y", "pos.z"],
            ["label", "X (m)", "Y (m)", "Z (m)"],
            ["x_coord", "x", "y", "z"],
            ["i", "Easting (m)", "Northing (m)", "Elevation (m)"],
            ["i", "//X", "Y", "Z"],
        ],
    )
    def test_coordinates(self, names):
        found = understood(names)
        assert [found[axis] for axis in "xyz"] == [1, 2, 3]

    def test_the_other_columns(self):
        names = [
            "normal_x",
            "ny",
            "Normals:2",
            "Weights",
            "color_r",
            "diffuse_green",
            "B",
            "xx",
            "px",
        ]
        found = understood(names)
        expected = ["nx", "ny", "nz", "weight", "red", "green", "blue"]
        assert found == {name: k for k, name in enumerate(expected)}

    @pytest.mark.parametrize(
        ("header", "message"),
        [
            (
                "i,lon,lat,alt",
                r"not known by their names \('i', 'lon', 'lat', 'alt'\); expected x, y",
            ),
            ("i,x,y,depth", "not known by their names"),
            ("i,x [mm],y [mm],z [m]", r"coordinates in different units \(m, mm\)"),
            ("X,x,y,z", r"several columns for x \('X', 'x'\); keep one"),
            ("w,coord_x,pos_x,y", "several columns for x"),
        ],
    )
    def test_what_is_not_understood_is_refused(self, load, header, message):
        with pytest.raises(TargetError, match=message):
            load("a.csv", f"{header}\n{text_of(np.ones(40), POINTS, delimiter=',')}")

    def test_words_in_other_columns(self, load):
        rows = "".join(f"maize A,{x!r},{y!r},{z!r}\n" for x, y, z in POINTS.tolist())
        np.testing.assert_array_equal(load("a.csv", "leaf,x,y,z\n" + rows).points, POINTS)


class TestTextWithoutNames:
    @pytest.mark.parametrize("first", [0, 1])
    def test_numbers_of_points_are_left_out(self, load, first):
        cloud = load("a.xyz", text_of(first + np.arange(40), POINTS))
        np.testing.assert_array_equal(cloud.points, POINTS)
        assert cloud.notes == ("the first column numbers the points, and was left out",)
        with pytest.raises(TargetError, match="two are left for x, y and z"):
            load("b.xyz", text_of(first + np.arange(40), POINTS[:, :2]))

    def test_a_column_of_classes_is_refused(self, load):
        with pytest.raises(TargetError, match=r"may be x, or a number or a class.* id x y z"):
            load("a.xyz", text_of(np.arange(40) % 3, POINTS))

    def test_whole_coordinates_are_no_classes(self, load):
        cloud = load("a.xyz", text_of(np.arange(40) % 7, np.arange(40) % 5, POINTS))
        assert cloud.notes == ()
        np.testing.assert_array_equal(cloud.points[:, 2], POINTS[:, 0])

    def test_pandas_numbers_its_columns(self, load):
        cloud = load("a.csv", "0,1,2\n" + text_of(POINTS, delimiter=","))
        np.testing.assert_array_equal(cloud.points, POINTS)
        assert cloud.notes == ("the first line numbers the columns, and was left out",)


class TestTextOfOtherPrograms:
    @pytest.mark.parametrize("name", ["a.pts", "a.xyz", "a.txt", "a.asc"])
    def test_a_line_with_the_number_of_points(self, load, name):
        rows = text_of(POINTS, np.full(40, -1200), np.full((40, 3), 7))
        np.testing.assert_array_equal(load(name, "40\n" + rows).points, POINTS)
        halves = "".join(f"20\n{text_of(half)}" for half in (POINTS[:20], POINTS[20:]))
        np.testing.assert_array_equal(load(name, halves).points, POINTS)
        with pytest.raises(TargetError, match="announces 41 points, but holds 40"):
            load(name, "41\n" + rows)

    @pytest.mark.parametrize("delimiter", [",", " "])
    def test_cloudcompare(self, load, delimiter):
        header = delimiter.join(["//X", "Y", "Z", "R", "G", "B", "Scalar field"])
        colours = np.tile([10, 200, 30], (40, 1))
        # Objects, so that bytes are written without decimals.
        rows = text_of(
            POINTS.astype(object), colours.astype(object), np.ones(40), delimiter=delimiter
        )
        cloud = load("a.txt", f"{header}\n40\n{rows}")
        np.testing.assert_array_equal(cloud.points, POINTS)
        np.testing.assert_allclose(cloud.colours, colours / 255)

    def test_r(self, load):
        def rows(delimiter: str) -> str:
            numbers = [f'"{k + 1}"{delimiter}' for k in range(40)]
            lines = text_of(POINTS, delimiter=delimiter).splitlines()
            return "".join(a + b + "\n" for a, b in zip(numbers, lines, strict=True))

        for header, delimiter in [('"","X","Y","Z"\n', ","), ('"X" "Y" "Z"\n', " "), ("", " ")]:
            cloud = load("a.csv", header + rows(delimiter))
            np.testing.assert_array_equal(cloud.points, POINTS)
        cloud = load("a.csv", '"","X","Y","Z"\n' + '"0",NA,NA,NA\n' + rows(","))
        np.testing.assert_array_equal(cloud.points, POINTS)
        assert cloud.notes == ("1 of 41 points are NaN or infinite, and were left out",)

    @pytest.mark.parametrize(
        "encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "utf-32"]
    )
    def test_encodings(self, load, encoding):
        text = "x\ty\tz\r\n" + text_of(POINTS, delimiter="\t")
        np.testing.assert_array_equal(load("a.csv", text.encode(encoding)).points, POINTS)

    def test_quoted_decimal_commas(self, load):
        rows = "".join(
            ",".join(f'"{x!r}"'.replace(".", ",") for x in row) + "\n" for row in POINTS.tolist()
        )
        np.testing.assert_array_equal(load("a.csv", '"x","y","z"\n' + rows).points, POINTS)

    @pytest.mark.parametrize("delimiter", [" ,", ", ", ",\t", " , "])
    def test_blanks_beside_commas(self, load, delimiter):
        whole = np.random.default_rng(1).integers(0, 9, (40, 3))
        cloud = load("a.txt", text_of(whole, delimiter=delimiter))
        np.testing.assert_array_equal(
            cloud.points, whole[whole.any(axis=1)] if cloud.notes else whole
        )


class TestPly:
    def test_lists_of_varying_length(self, load):
        rng = np.random.default_rng(1)
        rows = b""
        for k, point in enumerate(SINGLE):
            seen = rng.integers(0, 9, rng.integers(0, 5)).astype("<i4")
            rows += point.tobytes() + bytes([len(seen)]) + seen.tobytes() + struct.pack("<f", k)
        properties = "float x, float y, float z, list uchar int view, float weight"
        cloud = load("a.ply", ply_of(POINTS, properties, rows))
        np.testing.assert_array_equal(cloud.points, SINGLE)
        np.testing.assert_array_equal(cloud.weights, np.arange(40))

    @pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
    def test_triangles_and_quads_together(self, load, encoding):
        corners = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 1, 1]], "<f4")
        faces = [[4, 0, 1, 2, 3], [3, 3, 2, 4], [2, 0, 1]]
        if encoding == "ascii":
            rows = (
                text_of(corners) + "".join(" ".join(map(str, f)) + "\n" for f in faces)
            ).encode()
        else:
            rows = corners.tobytes() + b"".join(
                bytes([f[0]]) + np.array(f[1:], "<u4").tobytes() for f in faces
            )
        rest = "element face 3\nproperty list uchar uint vertex_indices"
        content = ply_of(corners, "float x, float y, float z", rows, rest)
        cloud = load("a.ply", content.replace(b"binary_little_endian", encoding.encode()))
        flat = (cloud.points[:, 2] == 0.0).mean()
        assert flat == pytest.approx(2 / 3, abs=0.1)

    def test_normals_that_are_no_normals_are_left_out(self, load):
        def read(normals: np.ndarray) -> PointCloud:
            rows = np.column_stack([POINTS, normals]).astype("<f4").tobytes()
            names = "float x, float y, float z, float nx, float ny, float nz"
            return load("a.ply", ply_of(POINTS, names, rows))

        assert read(POINTS).normals is not None
        splat = read(np.zeros((40, 3)))
        assert (splat.normals, splat.notes) == (None, ())
        for bad in (0.0, np.nan):
            cloud = read(np.where(np.arange(40)[:, None] < 2, bad, POINTS))
            assert cloud.normals is None
            assert cloud.notes[0].startswith("2 of 40 normals are zero or NaN")

    @pytest.mark.parametrize(
        ("kind", "code", "value", "expected", "noted"),
        [
            ("uchar", "u1", 51, 0.2, False),
            ("ushort", "<u2", 13107, 0.2, True),
            ("ushort", "<u2", 51, 0.2, False),
            ("float", "<f4", 0.25, 0.25, False),
            ("float", "<f4", -1.0, None, True),
            ("float", "<f4", np.nan, None, True),
        ],
    )
    def test_colours(self, load, kind, code, value, expected, noted):
        rows = np.empty(40, [("p", "<f4", 3), ("c", code, 3)])
        rows["p"], rows["c"] = POINTS, value
        names = f"float x, float y, float z, {kind} red, {kind} green, {kind} blue"
        cloud = load("a.ply", ply_of(POINTS, names, rows.tobytes()))
        if expected is None:
            assert cloud.colours is None
        else:
            np.testing.assert_allclose(cloud.colours, expected)
        assert bool(cloud.notes) == noted

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (b"vertex 40", b"vertex 4x", "its header has the line 'element vertex 4x'"),
            (b"vertex 40", b"vertex 41", "41 vertices announced, 40 found"),
            (b"float x", b"half x", "the line 'property half x'"),
            (b"float x", b"float a", r"not known by their names \('a', 'y', 'z'\)"),
            (b"end_header", b"end_headex", "its header has the line"),
            (b"format", b"comment", "names no format"),
            (b"ply\n", b"poly\n", "does not begin with ply"),
        ],
    )
    def test_damaged_headers(self, load, old, new, message):
        content = ply_of(POINTS, "float x, float y, float z", SINGLE.tobytes())
        with pytest.raises(TargetError, match=message):
            load("a.ply", content.replace(old, new, 1))


class TestPcd:
    @pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
    def test_points_and_colours(self, load, encoding):
        cloud = load("a.pcd", pcd_of(POINTS, encoding, colour=0x0033FF66))
        np.testing.assert_array_equal(cloud.points, SINGLE)
        np.testing.assert_allclose(cloud.colours, np.tile([0.2, 1.0, 0.4], (40, 1)))
        plain = load("a.pcd", pcd_of(POINTS, encoding))
        assert plain.colours is None

    def test_pixels_without_depth_are_left_out(self, load):
        points = np.where(np.arange(40)[:, None] % 4 == 0, np.nan, POINTS)
        cloud = load("a.pcd", pcd_of(points, "binary"))
        assert len(cloud) == 30
        assert cloud.notes == ("10 of 40 points are NaN or infinite, and were left out",)

    @pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
    def test_cut_short(self, load, encoding):
        content = pcd_of(POINTS, encoding)
        with pytest.raises(TargetError, match=r"is (damaged|cut short)"):
            load("a.pcd", content[:-40])


class TestSurveys:
    @pytest.mark.parametrize("suffix", [".las", ".laz"])
    def test_las(self, tmp_path, suffix):
        colours = np.tile([65535, 13107, 0], (40, 1))
        cloud = PointCloud.load(las_of(POINTS, tmp_path / f"a{suffix}", colours))
        np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
        np.testing.assert_allclose(cloud.colours, colours / 65535)
        plain = PointCloud.load(las_of(POINTS, tmp_path / f"b{suffix}"))
        assert plain.colours is None

    def test_e57_in_one_frame(self, tmp_path):
        path = e57_of([POINTS[:20], POINTS[20:]], tmp_path / "a.e57", np.array([1.0, 2.0, 3.0]))
        cloud = PointCloud.load(path)
        np.testing.assert_allclose(cloud.points, POINTS + np.array([1.0, 2.0, 3.0]), atol=1e-6)

    @pytest.mark.parametrize(("name", "package"), [("a.laz", "laspy"), ("a.e57", "pye57")])
    def test_without_their_package(self, load, monkeypatch, name, package):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(
            TargetError, match=rf"need the package {package}; install it with pip inst"
        ):
            load(name, b"LASF")


class TestMeshes:
    def test_off(self, load):
        box = trimesh.creation.box()
        np.testing.assert_allclose(
            load("a.off", box.export(file_type="off")).extent, 1.0, atol=0.05
        )

    def test_colours_of_vertices(self, load):
        text = "".join(f"v {x} {y} {z} 0.2 0.4 0.6\n" for x, y, z in POINTS)
        np.testing.assert_allclose(load("a.obj", text).colours[0], [0.2, 0.4, 0.6], atol=1 / 255)
        assert load("b.obj", text.replace(" 0.2 0.4 0.6", "")).colours is None

    @pytest.mark.parametrize("kind", ["stl", "glb", "obj", "ply", "off"])
    def test_pieces_are_named(self, load, kind):
        box = trimesh.creation.box()
        one = load(f"one.{kind}", box.export(file_type=kind))
        assert one.notes == ()
        far = trimesh.creation.box(extents=[2, 2, 2]).apply_translation([9, 0, 0])
        crumb = trimesh.creation.box(extents=[0.1, 0.1, 0.1]).apply_translation([0, 9, 0])
        pair = trimesh.util.concatenate([box, far, crumb])
        two = load(f"two.{kind}", pair.export(file_type=kind))
        assert len(two.notes) == 1
        assert two.notes[0].startswith("the mesh has 2 separate pieces (80 %, 20 % of its area)")

    def test_small_crumbs_are_not_mentioned(self, load):
        crumb = trimesh.creation.box(extents=[0.1, 0.1, 0.1]).apply_translation([0, 9, 0])
        pair = trimesh.util.concatenate([trimesh.creation.box(), crumb])
        assert load("a.ply", pair.export(file_type="ply")).notes == ()

    def test_a_scene_that_promises_too_much_is_refused(self, load):
        content = (
            '{"asset": {"version": "2.0"}, "accessors": [{"componentType": 5126, "type": "VEC3", '
            '"count": 9000000000}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], '
            '"nodes": [{"mesh": 0}]}'
        )
        with pytest.raises(TargetError, match=r"takes 2\.7e\+03 GB of memory"):
            load("a.gltf", content)


class TestConditions:
    def test_rows_that_are_not_finite(self, load):
        points = np.where(np.arange(40)[:, None] % 9 == 0, np.nan, POINTS)
        cloud = load("a.xyz", text_of(points, POINTS / np.linalg.norm(POINTS, axis=1)[:, None]))
        np.testing.assert_array_equal(cloud.points, points[np.isfinite(points[:, 0])])
        assert len(cloud.normals) == 35
        assert cloud.notes == ("5 of 40 points are NaN or infinite, and were left out",)
        with pytest.raises(TargetError, match="holds no point: all 40 are NaN"):
            load("b.xyz", text_of(np.full((40, 3), np.nan)))

    def test_points_at_the_origin(self, load):
        few = load("a.xyz", text_of(np.vstack([POINTS, np.zeros((19, 3))])))
        assert (len(few), few.notes) == (59, ())
        many = load("b.xyz", text_of(np.vstack([POINTS, np.zeros((20, 3))])))
        np.testing.assert_array_equal(many.points, POINTS)
        assert many.notes[0].startswith(
            "20 of 60 points lie at exactly the origin, as depth cameras"
        )

    def test_points_that_coincide_elsewhere_are_named(self):
        cloud = PointCloud(np.vstack([POINTS, np.tile([1.0, 2.0, 3.0], (12, 1))])).each_once()
        assert cloud.mass.sum() == 41
        assert cloud.notes[0].startswith("12 of 52 points coincide at (1, 2, 3) and count as one")
        assert cloud.weighted(np.ones(52)).notes == cloud.notes

    @pytest.mark.parametrize("extent", [0.06, 20.0, 2000.0])
    def test_coordinates_that_are_rounded(self, load, extent):
        far = np.array([3.2e5, 5.49e6, 300.0])
        rounded = (far + extent * POINTS / 5).astype("<f4")
        content = ply_of(POINTS, "float x, float y, float z", rounded.tobytes())
        if extent < 1:
            with pytest.raises(TargetError, match=r"steps of 0\.5 in y .* their shape is lost"):
                load("a.ply", content)
        else:
            notes = load("a.ply", content).notes
            assert len(notes) == (extent < 100)
            assert all("steps of 0.5 in y" in note for note in notes)
        # The same numbers in double precision are as good as any.
        exact = np.column_stack([far + extent * POINTS / 5]).astype("<f8")
        assert (
            load("b.ply", ply_of(POINTS, "double x, double y, double z", exact.tobytes())).notes
            == ()
        )

    @pytest.mark.parametrize("thickness", [0.4, 1.0, 3.0])
    @pytest.mark.parametrize("n", [2000, 20000])
    def test_two_sheets_are_named(self, load, thickness, n):
        rng = np.random.default_rng(1)
        u, v = rng.uniform(-1.0, 1.0, (2, n))
        middle = np.column_stack([15 * u, 30 * v, 6 * v**2 - 4 * u**2])
        normal = np.column_stack([8 * u / 15, -12 * v / 30, np.ones(n)])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        noise = 0.03 * rng.normal(size=(n, 3))
        assert load("one.npy", saved(middle + noise)).notes == ()
        side = rng.integers(0, 2, (n, 1)) - 0.5
        (note,) = load("two.npy", saved(middle + thickness * side * normal + noise)).notes
        found = float(note.removeprefix("the points lie on two sheets that are ").split()[0])
        assert found == pytest.approx(thickness, rel=0.1)

    @pytest.mark.parametrize("unit", [1e-100, 1.0, 1e100])
    def test_tubes_and_clutter_are_no_two_sheets(self, unit):
        rng = np.random.default_rng(2)
        turn, along = rng.uniform(0.0, 2 * np.pi, 2000), rng.uniform(0.0, 30.0, 2000)
        tube = np.column_stack([np.cos(turn), np.sin(turn), along])
        assert sheet_notes(unit * tube) == []
        assert sheet_notes(unit * rng.normal(size=(2000, 3))) == []

    def test_weights(self, load):
        weights = np.where(np.arange(40) == 3, np.nan, 1.0)
        cloud = load("a.csv", "x,y,z,weight\n" + text_of(POINTS, weights, delimiter=","))
        assert cloud.weights[3] == 0.0
        assert cloud.notes == ("1 of 40 weights are NaN, and were set to 0",)
        none = load("b.csv", "x,y,z,weight\n" + text_of(POINTS, np.zeros(40), delimiter=","))
        assert none.weights is None
        assert none.notes == ("all weights are zero or NaN, and were left out",)


class TestArrays:
    def test_named_fields_and_images_of_points(self, tmp_path):
        rows = np.empty(40, [("id", "i4"), ("x", "f4"), ("y", "f4"), ("z", "f4")])
        for axis, name in enumerate("xyz"):
            rows[name] = POINTS[:, axis]
        np.save(tmp_path / "a.npy", rows)
        np.testing.assert_array_equal(PointCloud.load(tmp_path / "a.npy").points, SINGLE)
        np.save(tmp_path / "b.npy", POINTS.reshape(5, 8, 3))
        np.testing.assert_array_equal(PointCloud.load(tmp_path / "b.npy").points, POINTS)
        np.save(tmp_path / "c.npy", np.column_stack([POINTS, np.ones(40)]))
        np.testing.assert_array_equal(PointCloud.load(tmp_path / "c.npy").points, POINTS)


def test_whole_numbers_before_a_normal_are_coordinates():
    points = np.array([[0.0, 0, 0], [1, 0.5, 0], [2, 0, 0.5], [3, 0.25, 0.5]])
    table = np.column_stack([points, np.tile([0.0, 0, 1], (4, 1))])
    found = unnamed_columns(table)
    assert np.array_equal(found["points"], points)
    assert found["normals"] is not None
