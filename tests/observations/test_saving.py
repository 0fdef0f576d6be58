import os
import stat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from petalfit.observations import PointCloud
from petalfit.observations.atomic import atomic_path

WRITABLE = [".ply", ".xyz", ".csv", ".npy", ".npz"]
CLOUD = PointCloud(np.random.default_rng(0).normal(size=(7, 3)))


@st.composite
def clouds(draw) -> PointCloud:
    n = draw(st.integers(3, 12))
    numbers = st.floats(-1e100, 1e100)
    corners = [[0.0, 0.0, 0.0], [1e100, 0.0, 0.0], [0.0, 1e100, 0.0]]
    points = np.vstack([corners, draw(arrays(np.float64, (n - 3, 3), elements=numbers))])
    directions = arrays(np.float64, (n, 3), elements=st.floats(0.1, 1.0))
    weights = arrays(np.float64, n, elements=st.floats(1e-300, 1e300))
    normals = draw(st.none() | directions)
    return PointCloud(points, normals, draw(st.none() | weights))


@given(cloud=clouds(), suffix=st.sampled_from([*WRITABLE, ".PLY", ".NPZ"]))
def test_reading_gives_back_every_bit(tmp_path_factory, cloud, suffix):
    if suffix == ".npy":
        cloud = PointCloud(cloud.points, cloud.normals)
    path = tmp_path_factory.mktemp("saved") / f"cloud{suffix}"
    cloud.save(path)
    again = PointCloud.load(path)
    for name in ("points", "normals", "weights"):
        expected, found = getattr(cloud, name), getattr(again, name)
        if expected is None:
            assert found is None
        else:
            np.testing.assert_array_equal(found, expected)
    assert os.listdir(path.parent) == [path.name]


def test_text_is_plain(tmp_path):
    cloud = PointCloud(np.array([[0.1, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, 0.0, -3.0]]))
    cloud.save(tmp_path / "a.xyz")
    assert (tmp_path / "a.xyz").read_bytes() == b"0.1 0.0 0.0\n0.0 1e-09 0.0\n0.0 0.0 -3.0\n"
    PointCloud(cloud.points, weights=np.ones(3)).save(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().startswith("x,y,z,weight\n0.1,0.0,0.0,1.0\n")


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"suffix '\.stl'; clouds are saved as \.ply \.xyz"):
        CLOUD.save(tmp_path / "a.stl")


def test_npy_does_not_lose_weights(tmp_path):
    with pytest.raises(ValueError, match=r"would lose the weights; save the cloud as \.npz"):
        PointCloud(CLOUD.points, weights=np.ones(7)).save(tmp_path / "a.npy")
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, SystemExit])
@pytest.mark.parametrize("suffix", WRITABLE)
def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, error, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"old")

    def fail(*_arguments):
        raise error

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(error):
        CLOUD.save(path)
    assert os.listdir(tmp_path) == [path.name]
    assert path.read_bytes() == b"old"


class TestAtomicPath:
    @pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
    def test_half_a_file_is_removed(self, tmp_path, error):
        def write():
            with atomic_path(tmp_path / "a.txt") as temporary:
                assert temporary.parent == tmp_path
                assert temporary.suffix == ".txt"
                temporary.write_text("half")
                raise error

        with pytest.raises(error):
            write()
        assert not os.listdir(tmp_path)

    def test_replaces_what_was_there(self, tmp_path):
        path = tmp_path / "a.txt"
        path.write_text("old")
        with atomic_path(str(path)) as temporary:
            temporary.write_text("new")
            assert path.read_text() == "old"
        assert path.read_text() == "new"
        assert os.listdir(tmp_path) == ["a.txt"]

    def test_others_may_read_the_file_as_any_other(self, tmp_path):
        (tmp_path / "plain").write_text("")
        with atomic_path(tmp_path / "ours") as temporary:
            temporary.write_text("")
        modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "ours")}
        assert len(modes) == 1

    def test_a_link_stays_a_link(self, tmp_path):
        (tmp_path / "real").mkdir()
        (tmp_path / "real" / "a.txt").write_text("old")
        (tmp_path / "link.txt").symlink_to("real/a.txt")
        with atomic_path(tmp_path / "link.txt") as temporary:
            temporary.write_text("new")
        assert (tmp_path / "link.txt").is_symlink()
        assert (tmp_path / "real" / "a.txt").read_text() == "new"

    @pytest.mark.parametrize("path", ["/dev/null", os.curdir])
    def test_only_regular_files_are_replaced(self, path):
        def write():
            with atomic_path(path):
                raise AssertionError("the block must not be entered")

        with pytest.raises(OSError, match="exists and is not a regular file; choose another"):
            write()

    def test_a_missing_folder_is_reported(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            CLOUD.save(tmp_path / "nowhere" / "a.ply")
