"""Writing point clouds: PLY, delimited text and NumPy's own formats, all in full precision."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from petalfit.observations.atomic import atomic_path
from petalfit.observations.columns import Columns

_COLOURS = ["red", "green", "blue"]


def write_columns(cloud: Columns, path: str | os.PathLike[str]) -> None:
    """Writes a cloud, completely or not at all; reading it back gives exactly the same numbers.

    - `.ply`: binary, in double precision, with nx, ny, nz, weight and red, green, blue if there are any;
      colours are bytes if those lose nothing, otherwise doubles from 0 to 1.
    - `.csv`: numbers between commas, with a header.
    - `.xyz`: numbers between blanks; a header, as a comment, only if there are weights or colours.
    - `.npy`: (N, 3), or (N, 6) with normals.
    - `.npz`: `points`, `normals`, `weights`, `colours`.

    Args:
        cloud: The columns of the cloud, already checked.
        path: The path of the file, whose suffix names the format. An existing file is replaced.

    Raises:
        ValueError: The suffix is none of these, or the format cannot hold weights or colours.
        OSError: The file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        raise ValueError(f"{path} has the suffix {suffix!r}; clouds are saved as {_SUFFIXES}.")
    for what in ("weights", "colours"):
        if suffix == ".npy" and cloud[what] is not None:
            raise ValueError(f"{path} would lose the {what}; save the cloud as .npz instead.")
    with atomic_path(path) as temporary:
        _WRITERS[suffix](cloud, temporary)


def _table(cloud: Columns) -> tuple[list[str], Float64[np.ndarray, "n k"]]:
    """The names of all columns of a cloud, and the columns as one table."""
    names, columns = ["x", "y", "z"], [cloud["points"]]
    if cloud["normals"] is not None:
        names += ["nx", "ny", "nz"]
        columns.append(cloud["normals"])
    if cloud["weights"] is not None:
        names.append("weight")
        columns.append(cloud["weights"][:, None])
    if cloud["colours"] is not None:
        names += _COLOURS
        columns.append(cloud["colours"])
    return names, np.hstack(columns)


def _write_ply(cloud: Columns, path: Path) -> None:
    names, table = _table(cloud)
    kinds = dict.fromkeys(names, ("double", "<f8"))
    if (
        cloud["colours"] is not None
        and (np.rint(255 * cloud["colours"]) / 255 == cloud["colours"]).all()
    ):
        table[:, -3:] = np.rint(255 * table[:, -3:])
        kinds |= dict.fromkeys(_COLOURS, ("uchar", "u1"))
    rows = np.empty(len(cloud["points"]), [(name, kind) for name, (_, kind) in kinds.items()])
    for name, column in zip(names, table.T, strict=True):
        rows[name] = column
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(cloud['points'])}",
        *(f"property {kind} {name}" for name, (kind, _) in kinds.items()),
        "end_header\n",
    ]
    path.write_bytes("\n".join(header).encode() + rows.tobytes())


def _write_csv(cloud: Columns, path: Path) -> None:
    names, table = _table(cloud)
    _write_lines(path, [",".join(names)], ",", table)


def _write_xyz(cloud: Columns, path: Path) -> None:
    names, table = _table(cloud)
    # Other programs read three or six columns without names; four or seven need names to be understood.
    bare = cloud["weights"] is None and cloud["colours"] is None
    header = [] if bare else ["# " + " ".join(names)]
    _write_lines(path, header, " ", table)


def _write_lines(
    path: Path, header: list[str], delimiter: str, table: Float64[np.ndarray, "n k"]
) -> None:
    # repr is the shortest text that reads back as the same float.
    rows = (delimiter.join(map(repr, row)) for row in table.tolist())
    path.write_text("\n".join([*header, *rows, ""]), encoding="utf-8", newline="\n")


def _write_npy(cloud: Columns, path: Path) -> None:
    # NumPy gets an open file, because it would append .npy to a path that ends in .NPY.
    with path.open("wb") as file:
        np.save(file, _table(cloud)[1])


def _write_npz(cloud: Columns, path: Path) -> None:
    arrays: dict[str, Any] = {**cloud}
    present = {name: array for name, array in arrays.items() if array is not None}
    with path.open("wb") as file:
        np.savez_compressed(file, **present)


_WRITERS: dict[str, Callable[[Columns, Path], None]] = {
    ".ply": _write_ply,
    ".xyz": _write_xyz,
    ".csv": _write_csv,
    ".npy": _write_npy,
    ".npz": _write_npz,
}

_SUFFIXES = " ".join(_WRITERS)
