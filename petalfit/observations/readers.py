"""Reading point clouds: PLY, OBJ, STL, GLB, glTF, delimited text and NumPy's own formats."""

import io
import json
import logging
import stat
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from petalfit.observations.columns import Columns, named_columns, read_text, unnamed_columns
from petalfit.observations.errors import TargetError
from petalfit.observations.triangles import DEFAULT_SAMPLES, geometry_columns

if TYPE_CHECKING:
    import trimesh.parent

# 2 GB are 80 million points in float64: more than any scan of a petal, or than a laptop can fit.
LARGEST_FILE = 2_000_000_000
# Extensions of glTF that trimesh does not know: it would read every vertex as zero.
COMPRESSIONS = (b"KHR_draco_mesh_compression", b"EXT_meshopt_compression")


def read_columns(path: Path, n: int = DEFAULT_SAMPLES, seed: int = 0) -> Columns:
    """Reads the columns of a point cloud, or samples a mesh.

    - `.ply .obj .stl .glb .gltf`: if there are faces, they are sampled uniformly by area, and each point
      gets the normal of its face; otherwise the vertices are the cloud, with the normals (nx, ny, nz),
      weights (weight) and colours (red, green, blue) of a PLY that has them.
    - `.xyz .txt .csv`: one point per line, see `petalfit.observations.columns.read_text`.
    - `.npy`: an array (N, 3), or (N, 6) with normals as in text without a header.
    - `.npz`: arrays `points`, `normals`, `weights`, `colours`, of which only the first is required;
      or a single array of any name, as in `.npy`.

    Args:
        path: The path of the file, of at most 2 GB (for `.npz`, uncompressed). Its suffix, in upper or
            lower case, names the format.
        n: The number of points to draw from a file with faces; without faces all vertices are used.
        seed: The seed of `numpy.random.default_rng`.

    Returns:
        The columns, in the file's unit of length and frame; their content is not checked yet.

    Raises:
        TargetError: The file is missing, unreadable, too large, or not of the format that its suffix
            names.
        ValueError: `n` is not positive.
    """
    _check_file(path)
    parsed = _parse(path)
    return parsed if isinstance(parsed, dict) else geometry_columns(parsed, n, seed)


def _check_file(path: Path) -> None:
    """Raises an error for everything that is wrong with a file and shows without opening it."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise TargetError("there is no such file; check the path.") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path.
        raise TargetError(f"cannot be opened ({_reason(error)}); check the path.") from error
    if stat.S_ISDIR(status.st_mode):
        raise TargetError("is a folder; give the path of a file in it.")
    if path.suffix.lower() not in SUFFIXES:
        raise TargetError(
            f"has the unknown suffix {path.suffix!r}; supported are {' '.join(SUFFIXES)}."
        )
    if not stat.S_ISREG(status.st_mode):
        raise TargetError("is not a regular file; copy its content to one first.")
    if status.st_size == 0:
        raise TargetError("is empty; export or copy it again.")
    _check_size(status.st_size)


def _check_size(size: int) -> None:
    if size > LARGEST_FILE:
        raise TargetError(
            f"holds {size / 1e9:.3g} GB, expected at most {LARGEST_FILE / 1e9:.3g} GB; "
            "thin the cloud or decimate the mesh first."
        )


def _parse(path: Path) -> "Columns | list[trimesh.parent.Geometry]":
    """The content of a file, read but not yet checked."""
    try:
        with _quiet():
            return _READERS[path.suffix.lower()](path)
    except TargetError:
        raise
    except (PermissionError, FileNotFoundError) as error:
        raise TargetError(
            f"cannot be read ({_reason(error)}); check its permissions, and the files it names."
        ) from error
    except Exception as error:  # NumPy and trimesh raise exceptions of any kind on damaged files.
        raise TargetError(
            f"is damaged, cut short or no {path.suffix.lower()} file of a kind that is supported "
            f"({_reason(error)}); copy it again, or export it again, a mesh as triangles."
        ) from error


def _reason(error: Exception) -> str:
    """The message of an exception, on one line and shortened."""
    if isinstance(error, ImportError):
        # Mostly trimesh, which asks for a package to guess the encoding of bytes that are not UTF-8.
        return f"not readable without the package {error.name}"
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text if len(text) <= 160 else text[:160] + '…'}"


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppresses trimesh's log and all warnings, except one that reports lost data."""
    # The level is set because the loggers of trimesh's modules inherit it.
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # np.fromstring, which trimesh uses on text, drops what it cannot parse.
            warnings.filterwarnings("error", "string or file could not be read to its end")
            yield
    finally:
        log.setLevel(level)


def _read_ply(path: Path) -> "Columns | list[trimesh.parent.Geometry]":
    import trimesh
    from trimesh.exchange.ply import load_ply

    with path.open("rb") as file:
        ply = load_ply(file, fix_texture=False, skip_materials=True)
    # The raw vertex element is used: trimesh drops a cloud's normals and properties it does not know.
    vertex = ply["metadata"]["_ply_raw"].get("vertex", {"length": 0})
    if not vertex["length"]:
        raise TargetError("holds no vertices; export it again.")
    found = len(ply["vertices"])
    if found != vertex["length"]:
        raise TargetError(f"is cut short: {vertex['length']} vertices announced, {found} found.")
    if ply.get("faces") is not None:
        return [trimesh.Trimesh(ply["vertices"], ply["faces"], process=False)]
    # A list property, whose kind names two types (of its length and of its items), is left out.
    names = [name for name, kind in vertex["properties"].items() if "," not in kind]
    table = [np.ravel(vertex["data"][name]).astype(np.float64) for name in names]
    return named_columns(np.column_stack(table), [name.lower() for name in names])


def _read_geometry(path: Path) -> "list[trimesh.parent.Geometry]":
    import trimesh
    from trimesh.resolvers import FilePathResolver

    kind = path.suffix.lower().removeprefix(".")
    data = path.read_bytes()
    if kind == "gltf":
        # Checked here: for a file that is not JSON, trimesh would only say that it finds no "model.gltf".
        json.loads(data)
    for compression in COMPRESSIONS:
        if kind in {"glb", "gltf"} and compression in data:
            raise TargetError(f"is compressed ({compression.decode()}); export it uncompressed.")
    if kind == "stl" and not _is_binary_stl(data):
        # A file that is not text either is cut short; with some packages trimesh guesses an encoding.
        data.decode("utf-8")
    # Decoded here: for names that are not UTF-8 trimesh would need another package.
    file = io.StringIO(data.decode("utf-8", "replace")) if kind == "obj" else io.BytesIO(data)
    # process=False, because trimesh would otherwise silently drop vertices that are NaN.
    scene = trimesh.load_scene(
        file,
        file_type=kind,
        resolver=FilePathResolver(str(path)),
        skip_materials=True,
        process=False,
    )
    # `dump` copies every mesh into the frame of the scene, once for each place where it appears.
    geometries = scene.dump()
    if not any(len(getattr(geometry, "vertices", ())) for geometry in geometries):
        raise TargetError(f"holds no vertices; it is empty, or no {path.suffix.lower()} file.")
    return geometries


def _is_binary_stl(data: bytes) -> bool:
    """Whether the file has as many triangles, of 50 bytes each, as its header of 84 bytes says."""
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def _read_npy(path: Path) -> Columns:
    with path.open("rb") as file:
        return _array_columns(np.lib.format.read_array(file, allow_pickle=False))


def _read_npz(path: Path) -> Columns:
    with zipfile.ZipFile(path) as archive:
        # Checked before anything is unpacked; zipfile unpacks no more than the directory says.
        _check_size(sum(member.file_size for member in archive.infolist()))
        members = {member.removesuffix(".npy"): member for member in archive.namelist()}
        if "points" not in members and len(members) != 1:
            raise TargetError(
                f"holds the arrays {', '.join(members) or '(none)'}; expected points and, "
                "optionally, normals, weights and colours, or a single array."
            )
        arrays: dict[str, np.ndarray] = {}
        for name in members.keys() & Columns.__annotations__.keys() or members:
            with archive.open(members[name]) as file:
                arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
    if "points" not in arrays:
        return _array_columns(*arrays.values())
    return {
        "points": arrays["points"],
        "normals": arrays.get("normals"),
        "weights": arrays.get("weights"),
        "colours": arrays.get("colours"),
    }


def _array_columns(array: np.ndarray) -> Columns:
    """The columns of an (N, 6) array by position; PointCloud checks any other array."""
    if array.ndim == 2 and array.shape[1] == 6 and array.dtype.kind in "fiu":
        return unnamed_columns(array.astype(np.float64))
    return {"points": array, "normals": None, "weights": None, "colours": None}


_READERS: dict[str, Callable[[Path], "Columns | list[trimesh.parent.Geometry]"]] = {
    ".ply": _read_ply,
    ".obj": _read_geometry,
    ".stl": _read_geometry,
    ".glb": _read_geometry,
    ".gltf": _read_geometry,
    ".xyz": read_text,
    ".txt": read_text,
    ".csv": read_text,
    ".npy": _read_npy,
    ".npz": _read_npz,
}

SUFFIXES: tuple[str, ...] = tuple(_READERS)
