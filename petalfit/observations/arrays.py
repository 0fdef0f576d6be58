"""NumPy's own files as point clouds."""

import zipfile
from pathlib import Path

import numpy as np

from petalfit.observations.columns import Columns, named_columns, unnamed_columns
from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory

_NAMES = ("points", "normals", "weights", "colours")


def read_npy(path: Path) -> Columns:
    """Reads an array: (N, 3), (H, W, 3), or one with more columns or with fields of their names."""
    with path.open("rb") as file:
        return _array_columns(np.lib.format.read_array(file, allow_pickle=False))


def read_npz(path: Path) -> Columns:
    """Reads the arrays `points`, `normals`, `weights` and `colours`, or a single array of any name."""
    with zipfile.ZipFile(path) as archive:
        # Checked before anything is unpacked; zipfile unpacks no more than the directory says.
        check_memory(3 * sum(member.file_size for member in archive.infolist()))
        members = {member.removesuffix(".npy"): member for member in archive.namelist()}
        if "points" not in members and len(members) != 1:
            raise TargetError(
                f"holds the arrays {', '.join(members) or '(none)'}; expected points and, "
                "optionally, normals, weights and colours, or a single array."
            )
        arrays: dict[str, np.ndarray] = {}
        for name in members.keys() & {*_NAMES} or members:
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
    """The columns of one array, by name or by position; PointCloud checks what is neither."""
    if array.dtype.names:
        rows = array.reshape(-1)
        return named_columns({name: rows[name] for name in array.dtype.names})
    if array.ndim == 3 and array.shape[2] == 3 and array.dtype.kind in "fiu":
        # The points of a depth camera, by row and column of its image.
        array = array.reshape(-1, 3)
    is_table = array.ndim == 2 and array.shape[1] > 3 and (len(array) > 3 or array.shape[1] == 6)
    if is_table and array.dtype.kind in "fiu":
        return unnamed_columns(array.astype(np.float64))
    return {"points": array, "normals": None, "weights": None, "colours": None}
