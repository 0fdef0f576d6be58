import base64
import json
import logging
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from petalfit.observations import SUFFIXES, PointCloud, TargetError

POINTS = np.random.default_rng(0).normal(size=(12, 3))
NORMALS = PointCloud(POINTS, normals=POINTS[::-1]).normals
DATA = Path(__file__).parents[2].parent / "shared" / "data"
SCANS = sorted(DATA.glob("scans/*.ply"))
MESHES = sorted(DATA.glob("petals/*.ply")) + sorted(DATA.glob("*.ply"))


def text_of(*tables: np.ndarray, delimiter: str = " ") -> str:
    rows = np.column_stack(tables).tolist()
    return "".join(delimiter.join(map(repr, row)) + "\n" for row in rows)


def ply_header(encoding: str, n: int, properties: str) -> str:
    lines = [f"property {entry}" for entry in properties.split(", ")]
    return "\n".join(["ply", f"format {encoding} 1.0", f"element vertex {n}", *lines, ""])


def sphere(kind: str, **options: str) -> bytes:
    """A file of the unit icosphere."""
    data = trimesh.creation.icosphere(2).export(file_type=kind, **options)
    return data.encode() if isinstance(data, str) else data


@pytest.fixture
def file(tmp_path):
    def write(name: str, content: bytes | str) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def refused(path: str | os.PathLike[str], message: str, n: int = 100) -> None:
    """Asserts that a file is refused with a message that begins with its path."""
    with pytest.raises(TargetError, match=message) as caught:
        PointCloud.load(path, n=n)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(path)) + 420


class TestMeshes:
    @pytest.mark.parametrize(
        ("name", "content"),
        [
            ("a.ply", sphere("ply")),
            ("a.PLY", sphere("ply", encoding="ascii")),
            ("a.obj", sphere("obj")),
            ("latin.obj", b"# gr\xfcn\no gr\xfcn\n" + sphere("obj")),
            ("a.stl", sphere("stl")),
            ("a.Stl", sphere("stl_ascii")),
            ("a.glb", sphere("glb")),
        ],
    )
    def test_faces_are_sampled(self, file, name, content):
        path = file(name, content)
        cloud = PointCloud.load(path, n=2000, seed=3)
        assert len(cloud) == 2000
        radius = np.linalg.norm(cloud.points, axis=1)
        assert 0.95 < radius.min() <= radius.max() <= 1.0 + 1e-6
        assert (np.einsum("nk,nk->n", cloud.points, cloud.normals) > 0.95).all()
        # The mean of n points that are uniform on the sphere has a variance of 1/3n a coordinate.
        assert np.abs(cloud.centroid).max() < 4.0 / np.sqrt(3.0 * 2000)
        np.testing.assert_array_equal(PointCloud.load(path, n=2000, seed=3).points, cloud.points)
        assert not np.array_equal(PointCloud.load(path, n=2000, seed=4).points, cloud.points)

    def test_gltf_with_its_buffers_beside_it(self, file, tmp_path):
        parts = trimesh.Scene(trimesh.creation.box()).export(file_type="gltf")
        for name, content in parts.items():
            file(name, content)
        np.testing.assert_allclose(PointCloud.load(tmp_path / "model.gltf").extent, 1.0, atol=0.01)
        (tmp_path / "gltf_buffer_0.bin").unlink()
        refused(tmp_path / "model.gltf", "FileNotFoundError: .*gltf_buffer_0.bin.*files it names")

    def test_gltf_in_one_file(self, file):
        parts = trimesh.Scene(trimesh.creation.box()).export(file_type="gltf")
        model = json.loads(parts["model.gltf"])
        for buffer in model["buffers"]:
            content = base64.b64encode(parts[buffer["uri"]]).decode()
            buffer["uri"] = f"data:application/octet-stream;base64,{content}"
        assert len(PointCloud.load(file("a.gltf", json.dumps(model)), n=50)) == 50

    def test_scenes_keep_their_places(self, file):
        scene = trimesh.Scene(trimesh.creation.box())
        shift = trimesh.transformations.translation_matrix([9, 0, 0])
        scene.add_geometry(trimesh.creation.box(), transform=shift)
        cloud = PointCloud.load(file("a.glb", scene.export(file_type="glb")))
        np.testing.assert_allclose(cloud.extent, [10.0, 1.0, 1.0], atol=0.01)

    def test_polygons_are_triangulated(self, file):
        header = ply_header("ascii", 5, "double x, double y, double z")
        faces = "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        corners = "0 0 0\n2 0 0\n2 1 0\n0 1 0\n0 1 1\n"
        path = file("a.ply", header + faces + corners + "4 0 1 2 3\n3 3 2 4\n")
        assert (PointCloud.load(path, n=3000).points[:, 2] == 0.0).mean() == pytest.approx(
            2.0 / 3.0, abs=4.0 * np.sqrt(2.0 / 9.0 / 3000)
        )

    @pytest.mark.parametrize("kind", ["ply", "obj", "stl", "glb"])
    def test_a_corner_that_is_not_finite_is_not_dropped(self, file, kind):
        box = trimesh.creation.box()
        vertices = np.array(box.vertices)
        vertices[0] = np.nan
        content = trimesh.Trimesh(vertices, box.faces, process=False).export(file_type=kind)
        refused(file(f"a.{kind}", content), r"NaN.* in \d of 12 faces, the first is face \d+; rem")

    def test_n_must_be_positive(self, file):
        with pytest.raises(ValueError, match="n is 0") as caught:
            PointCloud.load(file("a.stl", sphere("stl")), n=0)
        assert not isinstance(caught.value, TargetError)

    @pytest.mark.parametrize("extension", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
    def test_compressed_gltf_is_refused(self, file, extension):
        content = json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": [extension]})
        refused(file("a.gltf", content), rf"is compressed \({extension}\); export it uncompressed")


class TestVertexClouds:
    def test_every_vertex_is_taken(self, file):
        path = file("a.obj", "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in POINTS.tolist()))
        cloud = PointCloud.load(path, n=3)
        np.testing.assert_array_equal(cloud.points, POINTS)
        assert cloud.normals is None

    def test_glb(self, file):
        scene = trimesh.Scene(trimesh.PointCloud(POINTS))
        cloud = PointCloud.load(file("a.glb", scene.export(file_type="glb")))
        np.testing.assert_array_equal(cloud.points, POINTS.astype(np.float32))

    @pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
    @pytest.mark.parametrize("kind", ["float", "double"])
    def test_ply_with_everything(self, file, encoding, kind):
        names = ["red", "x", "y", "z", "nx", "ny", "nz", "weight"]
        header = ply_header(encoding, 12, ", ".join(f"{kind} {name}" for name in names))
        header += "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
        weights = np.arange(12.0)
        table = np.column_stack([np.ones(12), POINTS, NORMALS, weights])
        code = {"float": "f4", "double": "f8"}[kind]
        if encoding == "ascii":
            body = text_of(table).encode()
        else:
            body = table.astype((">" if "big" in encoding else "<") + code).tobytes()
        cloud = PointCloud.load(file("a.ply", header.encode() + body))
        np.testing.assert_array_equal(cloud.points, POINTS.astype(code))
        np.testing.assert_allclose(cloud.normals, NORMALS, atol=2e-16 if code == "f8" else 1e-7)
        np.testing.assert_array_equal(cloud.weights, weights)


class TestText:
    @pytest.mark.parametrize("suffix", [".xyz", ".txt", ".csv", ".XYZ"])
    @pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", "   ", ", "])
    def test_delimiters_and_comments(self, file, suffix, delimiter):
        text = f"# a scan\n\n{text_of(POINTS, delimiter=delimiter)}# the end\n"
        cloud = PointCloud.load(file("a" + suffix, text.replace("\n", "  # why\r\n")))
        np.testing.assert_array_equal(cloud.points, POINTS)

    def test_semicolons_allow_decimal_commas(self, file):
        text = "x;y;z\n" + text_of(POINTS, delimiter=";").replace(".", ",")
        np.testing.assert_array_equal(PointCloud.load(file("a.csv", text)).points, POINTS)

    @pytest.mark.parametrize("delimiter", [" ", "\t", ";"])
    def test_decimal_commas(self, file, delimiter):
        text = text_of(POINTS, delimiter=delimiter).replace(".", ",")
        np.testing.assert_array_equal(PointCloud.load(file("a.txt", text)).points, POINTS)

    @pytest.mark.parametrize(
        "header", ["x,y,z", "# x y z", "// X Y Z", "\ufeffX;Y;Z", "East North Up", '"x","y","z"']
    )
    def test_headers(self, file, header):
        cloud = PointCloud.load(file("a.csv", f"{header}\n{text_of(POINTS)}"))
        np.testing.assert_array_equal(cloud.points, POINTS)

    def test_names_say_which_column_is_which(self, file):
        weights = np.arange(12.0)
        table = [weights, NORMALS, POINTS[:, ::-1], np.ones(12)]
        text = ",weight,nx,ny,nz,z,y,x,red\n" + text_of(np.arange(12), *table, delimiter=",")
        cloud = PointCloud.load(file("a.csv", text))
        np.testing.assert_array_equal(cloud.points, POINTS)
        np.testing.assert_array_equal(cloud.normals, NORMALS)
        np.testing.assert_array_equal(cloud.weights, weights)

    @pytest.mark.parametrize("columns", [1, 2, 4])
    def test_columns_without_names_beyond_the_third_are_ignored(self, file, columns):
        cloud = PointCloud.load(file("a.xyz", text_of(POINTS, NORMALS[:, :1], *[POINTS] * 2)))
        np.testing.assert_array_equal(cloud.points, POINTS)
        cloud = PointCloud.load(file("b.xyz", text_of(POINTS, np.ones((12, columns)))))
        assert cloud.normals is None
        assert cloud.weights is None

    @pytest.mark.parametrize("suffix", [".xyz", ".npy"])
    def test_six_columns_are_normals_if_they_can_be(self, file, tmp_path, suffix):
        def read(extra: np.ndarray) -> PointCloud:
            if suffix == ".xyz":
                return PointCloud.load(file("a.xyz", text_of(POINTS, extra)))
            np.save(tmp_path / "a.npy", np.column_stack([POINTS, extra]))
            return PointCloud.load(tmp_path / "a.npy")

        np.testing.assert_array_equal(read(NORMALS).normals, NORMALS)
        np.testing.assert_allclose(read(NORMALS.round(2)).normals, NORMALS, atol=0.02)
        rng = np.random.default_rng(0)
        assert read(rng.uniform(size=(12, 3))).normals is None
        assert read(rng.integers(0, 256, (12, 3))).normals is None
        assert read(np.zeros((12, 3))).normals is None
        some = read(np.where(np.arange(12)[:, None] == 4, 0.0, NORMALS))
        assert some.normals is None
        assert some.notes[0].startswith(
            "1 of 12 normals are zero or NaN: all normals were left out"
        )

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                "1 2 3\n# no\n1 2\n",
                r"line 3 has another number of columns \(2\) .* \(3\): '1 2'; c",
            ),
            ("1 2\n1 2\n", r"line 1 has too few columns \(2\) for x, y and z: '1 2'"),
            ("x y z\n1 2 3\n1 2 three\n", "line 3 has 'three' for a number: '1 2 three'; correct"),
            ("x y z\nx y z\n", "line 2 has 'x' for a number: 'x y z'"),
            ("1 2 3\n1 2 " + "3 4 " * 99, r"line 2 has another.*\(200\).*: '1 2 .{56}'…; correct"),
            ("1,2,3\n1,,3\n", "line 2 has '' for a number: '1,,3'"),
            ("x y z w\n1 2 3\n", "has 4 names in its header, but 3 columns of numbers"),
            ("# nothing\n\n", "holds no points, expected lines of at least three numbers"),
            ("x y z\n", "holds no points"),
            ("0 0 0\n1 0 0\n2 0 0\n", "points all lie on one line"),
            (bytes(range(256)) * 9, "is no text: line 1 has zero bytes or no end"),
        ],
    )
    def test_malformed_text_is_refused(self, file, text, message):
        refused(file("a.xyz", text), message)


class TestArrays:
    @pytest.mark.parametrize("kind", ["<f8", ">f4", "<f2", "<i4"])
    def test_npy(self, tmp_path, kind):
        points = (10.0 * POINTS).astype(kind)
        np.save(tmp_path / "a.npy", np.asfortranarray(points))
        np.testing.assert_array_equal(PointCloud.load(tmp_path / "a.npy").points, points)

    def test_npz(self, tmp_path):
        path = tmp_path / "a.npz"
        weights = np.arange(12.0)
        np.savez(path, points=POINTS, normals=NORMALS, weights=weights, names=np.array([None]))
        cloud = PointCloud.load(path)
        np.testing.assert_array_equal(cloud.points, POINTS)
        np.testing.assert_array_equal(cloud.normals, NORMALS)
        np.testing.assert_array_equal(cloud.weights, weights)

    def test_npz_with_one_array(self, tmp_path):
        np.savez(tmp_path / "a.npz", np.column_stack([POINTS, NORMALS]))
        np.testing.assert_array_equal(PointCloud.load(tmp_path / "a.npz").normals, NORMALS)

    @pytest.mark.parametrize(
        ("arrays", "message"),
        [
            ({"vertices": POINTS, "faces": POINTS}, "holds the arrays vertices, faces; expected p"),
            ({}, r"holds the arrays \(none\); expected points"),
            ({"points": POINTS.T}, r"shape \(3, 12\), expected \(N, 3\); transpose them"),
            ({"points": POINTS, "weights": POINTS}, r"weights have shape \(12, 3\)"),
            ({"points": POINTS.astype(object)}, "allow_pickle=False"),
        ],
    )
    def test_npz_without_a_cloud_is_refused(self, tmp_path, arrays, message):
        np.savez(tmp_path / "a.npz", **arrays)
        refused(tmp_path / "a.npz", message)

    @pytest.mark.parametrize(
        ("array", "message"),
        [
            (POINTS.T, r"shape \(3, 12\)"),
            (POINTS.astype(object), "allow_pickle=False"),
            (POINTS.astype(str), "points have the type <U32"),
            (np.ones((12, 6), bool), r"points have the type bool"),
        ],
    )
    def test_npy_without_a_cloud_is_refused(self, tmp_path, array, message):
        np.save(tmp_path / "a.npy", array)
        refused(tmp_path / "a.npy", message)

    def test_a_zip_bomb_is_not_unpacked(self, tmp_path, monkeypatch):
        path = tmp_path / "a.npz"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("points.npy", b"\0" * 1000)
        # The uncompressed size, in the central directory alone: four bytes, 24 after its mark.
        content = bytearray(path.read_bytes())
        struct.pack_into("<I", content, content.rindex(b"PK\x01\x02") + 24, 3_000_000_000)
        path.write_bytes(content)
        monkeypatch.setattr("petalfit.observations.memory.available_memory", lambda: 2_000_000_000)
        refused(
            path, "takes 9 GB of memory to read, and 2 GB are available; thin the cloud or decim"
        )

    def test_an_array_that_promises_too_much_is_refused(self, file, tmp_path):
        np.save(tmp_path / "a.npy", POINTS)
        content = (tmp_path / "a.npy").read_bytes()
        promised = content.replace(b"(12, 3), }" + b" " * 12, b"(999999999999, 3), }  ", 1)
        assert promised != content
        refused(file("b.npy", promised), "is damaged, or does not fit into memory")


class TestFiles:
    def test_suffixes_are_the_documented_ones(self):
        assert " ".join(SUFFIXES) == (
            ".ply .obj .stl .off .glb .gltf .xyz .txt .asc .pts .csv .pcd .las .laz .e57 .npy .npz"
        )

    def test_missing(self, tmp_path):
        refused(tmp_path / "a.ply", "there is no such file; check the path")
        (tmp_path / "b.ply").write_text("")
        refused(tmp_path / "b.ply" / "a.ply", "there is no such file")
        (tmp_path / "c.ply").symlink_to("nowhere.ply")
        refused(tmp_path / "c.ply", "there is no such file")

    def test_impossible_paths(self):
        refused("a\0.ply", "cannot be opened .*null.*; check the path")
        refused("a" * 1000 + ".ply", "cannot be opened .*File name too long.*; check the path")

    def test_folder(self, tmp_path):
        folder = tmp_path / "scan.ply"
        folder.mkdir()
        refused(folder, "is a folder; give the path of a file in it")

    @pytest.mark.parametrize("name", ["a.doc", "ply", "a.ply.gz"])
    def test_unknown_suffix(self, file, name):
        message = r"unknown suffix '.*'; supported are \.ply \.obj .* \.npz\."
        refused(file(name, sphere("ply")), message)

    @pytest.mark.parametrize(
        ("suffix", "program"), [(".vtk", "ParaView"), (".VTP", "ParaView"), (".fbx", "Blender")]
    )
    def test_formats_of_other_programs(self, file, suffix, program):
        message = f"a format that is not read; save it as .ply from {program}"
        refused(file("a" + suffix, sphere("ply")), message)

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_empty(self, file, suffix):
        refused(file("a" + suffix, ""), "is empty; export or copy it again")

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
    def test_pipe(self, tmp_path):
        os.mkfifo(tmp_path / "a.xyz")
        refused(tmp_path / "a.xyz", "is not a regular file; copy its content to one first")

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_too_large(self, file, suffix, monkeypatch):
        path = file("a" + suffix, "")
        os.truncate(path, 2_500_000_000)  # Sparse: takes no space.
        monkeypatch.setattr("petalfit.observations.memory.available_memory", lambda: 4_000_000_000)
        refused(path, "takes 7.5 GB of memory to read, and 4 GB are available; thin the cloud or d")

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_without_permission(self, file, suffix, monkeypatch):
        # By force: to root, who runs many tests, every file is open.
        def refuse(*_arguments, **_options):
            raise PermissionError(13, "Permission denied")

        path = file("a" + suffix, "{}")
        monkeypatch.setattr("pathlib.Path.open", refuse)
        monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
        monkeypatch.setattr("zipfile.ZipFile", refuse)
        refused(path, "cannot be read .*Permission denied.*; check its permissions")

    @pytest.mark.parametrize("suffix", sorted({*SUFFIXES} - {".obj", ".off"}))
    def test_garbage(self, file, suffix):
        garbage = np.random.default_rng(1).bytes(5000)
        kind = suffix.removeprefix(".")
        message = rf"is damaged, cut short or no \.{kind} file .*\(|is no (text|.* file)"
        refused(file("a" + suffix, garbage), message)

    @pytest.mark.parametrize("name", ["a.obj", "a.stl"])
    def test_text_without_vertices(self, file, name):
        refused(file(name, "nothing of the kind\n"), "holds no vertices; it is empty, or no")

    def test_ply_without_vertices(self, file):
        header = ply_header("ascii", 0, "float x, float y, float z") + "end_header\n"
        refused(file("a.ply", header), "holds no vertices")

    @pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.95, 0.999])
    @pytest.mark.parametrize("kind", ["ply", "stl", "glb"])
    def test_cut_short(self, file, kind, share):
        content = sphere(kind)
        refused(file(f"a.{kind}", content[: int(share * len(content))]), "is (damaged|cut short)")

    def test_ascii_ply_cut_short(self, file):
        header = ply_header("ascii", 12, "float x, float y, float z") + "end_header\n"
        refused(file("a.ply", header + text_of(POINTS[:7])), "cut short: 12 vertices .*, 7 found")
        broken = text_of(POINTS).replace(repr(float(POINTS[5, 1])), "oops")
        refused(
            file("b.ply", header + broken), "is damaged: not all that follows its header are num"
        )
        shifted = text_of(POINTS) + "7\n"
        refused(file("c.ply", header + shifted), "announces 36 numbers, and 37 are found")

    @pytest.mark.parametrize("kind", ["npy", "npz"])
    def test_arrays_cut_short(self, tmp_path, file, kind):
        path = tmp_path / f"a.{kind}"
        PointCloud(POINTS).save(path)
        content = path.read_bytes()
        for share in (0.1, 0.5, 0.9):
            refused(file(f"b.{kind}", content[: int(share * len(content))]), "is damaged, cut shor")

    def test_trimesh_keeps_quiet(self, file, caplog, capfd):
        # An STL whose normals trimesh cannot parse, of which it logs a warning.
        content = sphere("stl_ascii").decode().replace("facet normal ", "facet normal ? ")
        before = logging.getLogger("trimesh").level
        PointCloud.load(file("a.stl", content), n=50)
        assert logging.getLogger("trimesh").level == before
        assert not caplog.records
        assert capfd.readouterr() == ("", "")


class TestThirdPartyData:
    @pytest.mark.skipif(not SCANS, reason="third-party scans are not in the project")
    def test_scans(self):
        for path in SCANS:
            cloud = PointCloud.load(path)
            assert 2000 < len(cloud) < 8000
            assert cloud.normals is None
            np.testing.assert_array_equal(cloud.points, trimesh.load(path).vertices)

    @pytest.mark.skipif(not MESHES, reason="third-party petals are not in the project")
    def test_petals(self):
        for path in MESHES:
            cloud = PointCloud.load(path, n=500)
            mesh = trimesh.load_mesh(path)
            low, high = mesh.bounds
            margin = 1e-6 * mesh.scale
            assert len(cloud) == len(cloud.normals) == 500
            assert (cloud.points >= low - margin).all()
            assert (cloud.points <= high + margin).all()
            deviation = mesh.triangles_center.T @ mesh.area_faces / mesh.area - cloud.centroid
            assert np.linalg.norm(deviation) < 4.0 * cloud.diagonal / np.sqrt(500)
