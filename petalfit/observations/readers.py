"""Reading point clouds and meshes of any format: each file goes to the reader that its suffix names."""

import logging
import stat
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from petalfit.observations.arrays import read_npy, read_npz
from petalfit.observations.columns import Columns, named_columns
from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory
from petalfit.observations.mending import mended
from petalfit.observations.pcd import read_pcd
from petalfit.observations.ply import read_ply
from petalfit.observations.scene import read_scene
from petalfit.observations.surveys import read_e57, read_las
from petalfit.observations.text import read_text
from petalfit.observations.triangles import DEFAULT_SAMPLES, geometry_columns

if TYPE_CHECKING:
    import trimesh.parent

# The content of a file, its numbers in double precision, and the arrays that are made of them.
_BYTES_A_BYTE = 3


def read_columns(path: Path, n: int = DEFAULT_SAMPLES, seed: int = 0) -> Columns:
    """Reads the columns of a point cloud, or samples a mesh.

    - `.ply .obj .stl .off .glb .gltf`: if there are faces, they are sampled uniformly by area, and each
      point gets the normal of its face; otherwise the vertices are the cloud, with the normals, weights
      and colours of a PLY that has them.
    - `.xyz .txt .asc .pts .csv`: one point per line, see `petalfit.observations.text.read_text`.
    - `.pcd`, and with `petalfit[formats]` also `.las .laz .e57`: the points with their colours.
    - `.npy`: an array (N, 3), or one with more columns as in text without a header.
    - `.npz`: arrays `points`, `normals`, `weights`, `colours`, of which only the first is required;
      or a single array of any name, as in `.npy`.

    Which column is which is said by its name, see `petalfit.observations.columns.understood`. What a fit
    cannot use is left out with a note, see `petalfit.observations.mending.mended`.

    Args:
        path: The path of the file, which must fit into memory. Its suffix, in upper or lower case, names
            the format.
        n: The number of points to draw from a file with faces; without faces all vertices are used.
        seed: The seed of `numpy.random.default_rng`.

    Returns:
        The columns, in the file's unit of length and frame, with notes on what was mended; their content
        is not checked yet.

    Raises:
        TargetError: The file is missing, unreadable, too large, or not of the format that its suffix
            names.
        ValueError: `n` is not positive.
    """
    _check_file(path)
    parsed = _parse(path)
    if not isinstance(parsed, dict):
        parsed = geometry_columns(parsed, n, seed)
    return mended(parsed)


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
    suffix = path.suffix.lower()
    if suffix in _OTHERS:
        raise TargetError(
            f"is in a format that is not read; save it as .ply from {_OTHERS[suffix]}."
        )
    if suffix not in SUFFIXES:
        raise TargetError(
            f"has the unknown suffix {path.suffix!r}; supported are {' '.join(SUFFIXES)}."
        )
    if not stat.S_ISREG(status.st_mode):
        raise TargetError("is not a regular file; copy its content to one first.")
    if status.st_size == 0:
        raise TargetError("is empty; export or copy it again.")
    check_memory(_BYTES_A_BYTE * status.st_size)


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
    except MemoryError:
        raise TargetError(
            "is damaged, or does not fit into memory; copy it again, or thin the cloud first."
        ) from None
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
    vertices, faces = read_ply(path)
    if not vertices or not len(next(iter(vertices.values()))):
        raise TargetError("holds no vertices; export it again.")
    columns = named_columns(vertices)
    if faces is None:
        return columns
    import trimesh

    return [trimesh.Trimesh(columns["points"], faces, process=False)]


_READERS: dict[str, Callable[[Path], "Columns | list[trimesh.parent.Geometry]"]] = {
    ".ply": _read_ply,
    ".obj": read_scene,
    ".stl": read_scene,
    ".off": read_scene,
    ".glb": read_scene,
    ".gltf": read_scene,
    ".xyz": read_text,
    ".txt": read_text,
    ".asc": read_text,
    ".pts": read_text,
    ".csv": read_text,
    ".pcd": read_pcd,
    ".las": read_las,
    ".laz": read_las,
    ".e57": read_e57,
    ".npy": read_npy,
    ".npz": read_npz,
}

SUFFIXES: tuple[str, ...] = tuple(_READERS)

# Formats that people have and no small library reads, and a program that does.
_OTHERS: dict[str, str] = {
    **dict.fromkeys((".vtk", ".vtp", ".vtu", ".vts"), "ParaView"),
    **dict.fromkeys((".ptx", ".fls", ".rcp", ".rcs", ".bin", ".dxf", ".shp"), "CloudCompare"),
    **dict.fromkeys((".blend", ".fbx", ".dae", ".3ds", ".usd", ".usdz", ".x3d"), "Blender"),
}
