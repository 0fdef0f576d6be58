"""Damaged files of every format: one sentence, and never anything else."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from formats import e57_of, las_of, pcd_of, ply_of, text_of

from petalfit.observations import PointCloud, TargetError

POINTS = np.random.default_rng(0).normal(size=(30, 3))
MESH = trimesh.creation.icosphere(1)
NAMES = "float x, float y, float z"
# Bytes that stand for much: line ends, delimiters, signs, the largest and the smallest numbers.
TELLING = b"\n\r\t ,;.-+#/\"'0123456789eEnN\x00\x01\x7f\x80\xff{}[]"
WORDS = (b"nan", b"inf", b"-1", b"99999999999", b"1e400", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f")


def sources(folder) -> dict[str, bytes]:
    """A sound file of every format."""
    PointCloud(POINTS, POINTS + 9.0, np.ones(30), np.full((30, 3), 0.3)).save(folder / "c.npz")
    np.save(folder / "c.npy", POINTS)
    e57_of([POINTS], folder / "c.e57")
    single = POINTS.astype("<f4").tobytes()
    lists = b"".join(
        row.tobytes() + bytes([k % 3]) + bytes(4 * (k % 3))
        for k, row in enumerate(POINTS.astype("<f4"))
    )
    found: dict[str, bytes | str] = {
        "cloud.ply": ply_of(POINTS, NAMES, single),
        "lists.ply": ply_of(POINTS, f"{NAMES}, list uchar int view", lists),
        "mesh.ply": MESH.export(file_type="ply"),
        "ascii.ply": MESH.export(file_type="ply", encoding="ascii"),
        "mesh.obj": MESH.export(file_type="obj"),
        "mesh.stl": MESH.export(file_type="stl"),
        "ascii.stl": MESH.export(file_type="stl_ascii"),
        "mesh.off": MESH.export(file_type="off"),
        "mesh.glb": MESH.export(file_type="glb"),
        "a.xyz": text_of(POINTS, POINTS),
        "a.csv": "id,x [mm],y [mm],z [mm]\n" + text_of(np.arange(30), POINTS, delimiter=","),
        "a.pts": "30\n" + text_of(POINTS, np.ones((30, 4))),
        "utf16.txt": ("x\ty\tz\n" + text_of(POINTS, delimiter="\t")).encode("utf-16"),
        "ascii.pcd": pcd_of(POINTS, "ascii", 255),
        "binary.pcd": pcd_of(POINTS, "binary", 255),
        "packed.pcd": pcd_of(POINTS, "binary_compressed", 255),
        "a.las": las_of(POINTS, folder / "c.las").read_bytes(),
        "a.laz": las_of(POINTS, folder / "c.laz").read_bytes(),
        "a.e57": (folder / "c.e57").read_bytes(),
        "a.npy": (folder / "c.npy").read_bytes(),
        "a.npz": (folder / "c.npz").read_bytes(),
    }
    return {name: x.encode() if isinstance(x, str) else x for name, x in found.items()}


NAMES_OF_SOURCES = [
    "cloud.ply",
    "lists.ply",
    "mesh.ply",
    "ascii.ply",
    "mesh.obj",
    "mesh.stl",
    "ascii.stl",
    "mesh.off",
    "mesh.glb",
    "a.xyz",
    "a.csv",
    "a.pts",
    "utf16.txt",
    "ascii.pcd",
    "binary.pcd",
    "packed.pcd",
    "a.las",
    "a.laz",
    "a.e57",
    "a.npy",
    "a.npz",
]


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> dict[str, bytes]:
    return sources(tmp_path_factory.mktemp("sound"))


def cut(rng: np.random.Generator, content: bytearray) -> None:
    del content[rng.integers(1, len(content)) :]


def flip(rng: np.random.Generator, content: bytearray) -> None:
    for _ in range(rng.integers(1, 9)):
        content[_place(rng, content)] = rng.integers(256)


def replace(rng: np.random.Generator, content: bytearray) -> None:
    content[_place(rng, content)] = rng.choice(list(TELLING))


def insert(rng: np.random.Generator, content: bytearray) -> None:
    place = _place(rng, content)
    content[place:place] = WORDS[rng.integers(len(WORDS))]


def overwrite(rng: np.random.Generator, content: bytearray) -> None:
    word, place = WORDS[rng.integers(len(WORDS))], _place(rng, content)
    content[place : place + len(word)] = word


def delete(rng: np.random.Generator, content: bytearray) -> None:
    place = _place(rng, content)
    del content[place : place + rng.integers(1, 60)]


def repeat(rng: np.random.Generator, content: bytearray) -> None:
    place = _place(rng, content)
    content[place:place] = content[place : place + rng.integers(1, 60)]


def _place(rng: np.random.Generator, content: bytearray) -> int:
    """A place in the file; every other one in its header."""
    return int(rng.integers(min(len(content), 400) if rng.random() < 0.5 else len(content)))


MUTATIONS: tuple[Callable[[np.random.Generator, bytearray], None], ...] = (
    cut, flip, replace, insert, overwrite, delete, repeat,
)  # fmt: skip


def mutated(content: bytes, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    damaged = bytearray(content)
    for _ in range(rng.integers(1, 3)):
        MUTATIONS[rng.integers(len(MUTATIONS))](rng, damaged)
        if not damaged:
            break
    return bytes(damaged)


def check(content: bytes, name: str, seeds: range, folder) -> None:
    """Asserts that damaged files are clouds or are refused in one sentence."""
    path = folder / name
    for seed in seeds:
        path.write_bytes(mutated(content, seed))
        try:
            cloud = PointCloud.load(path, n=50)
        except TargetError as error:
            said = str(error)
            assert said.startswith(f"{path}: "), f"seed {seed}"
            assert "\n" not in said, f"seed {seed}"
        except Exception as error:
            raise AssertionError(f"seed {seed} of {name}: {error!r}") from error
        else:
            assert np.isfinite(cloud.points).all(), f"seed {seed}"


@pytest.mark.parametrize("name", NAMES_OF_SOURCES)
def test_sound_files_are_read(sound, tmp_path, name):
    (tmp_path / name).write_bytes(sound[name])
    assert len(PointCloud.load(tmp_path / name, n=30)) == 30


@pytest.mark.parametrize("name", NAMES_OF_SOURCES)
def test_damaged_files(sound, tmp_path, name):
    check(sound[name], name, range(100), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES_OF_SOURCES)
def test_many_damaged_files(sound, tmp_path, name):
    check(sound[name], name, range(1000, 3000), tmp_path)
