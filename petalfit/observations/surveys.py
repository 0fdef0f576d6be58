"""The files of surveys: LAS, LAZ and E57. Their readers are installed with `petalfit[formats]`."""

from pathlib import Path

import numpy as np

from petalfit.observations.columns import Columns
from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory

_BYTES_A_POINT = 200


def read_las(path: Path) -> Columns:
    """Reads LAS or LAZ, with colours if there are any.

    Args:
        path: The path of the file.

    Raises:
        TargetError: laspy is not installed, or the points do not fit into memory.
    """
    try:
        import laspy
    except ImportError:
        raise _not_installed("LAS and LAZ files", "laspy") from None

    with path.open("rb") as opened, laspy.open(opened) as file:
        header = file.header
        _check_las(path, header.point_count, header.point_format.size, header.are_points_compressed)
        check_memory(_BYTES_A_POINT * header.point_count)
        points = file.read()
    names = {*points.point_format.dimension_names}
    colours = None
    if {"red", "green", "blue"} <= names:
        colours = np.array([points.red, points.green, points.blue]).T
    return _columns(np.array([points.x, points.y, points.z]).T, colours)


def _check_las(path: Path, count: int, size: int, is_compressed: bool) -> None:
    if count == 0:
        raise TargetError("holds no points; export it again.")
    found = path.stat().st_size // size
    if not is_compressed and found < count:
        raise TargetError(
            f"is cut short: {count} points announced, at most {found} found; copy it again."
        )


def read_e57(path: Path) -> Columns:
    """Reads all scans of an E57 file in their common frame, with colours if all of them have some.

    Args:
        path: The path of the file.

    Raises:
        TargetError: pye57 is not installed, there are no points, or they do not fit into memory.
    """
    try:
        import pye57
    except ImportError:
        raise _not_installed("E57 files", "pye57") from None

    with path.open("rb") as opened:
        if opened.read(8) != b"ASTM-E57":
            raise TargetError("is no E57 file: it does not begin with ASTM-E57; export it again.")
    file = pye57.E57(str(path))
    try:
        counts = [file.get_header(k).point_count for k in range(file.scan_count)]
        if not sum(counts):
            raise TargetError("holds no points; export it again.")
        check_memory(_BYTES_A_POINT * sum(counts))
        scans = [
            file.read_scan(k, colors=True, ignore_missing_fields=True)
            for k, count in enumerate(counts)
            if count
        ]
    finally:
        file.close()
    points = [np.column_stack([scan[f"cartesian{axis}"] for axis in "XYZ"]) for scan in scans]
    channels = ("colorRed", "colorGreen", "colorBlue")
    colours = None
    if all(channel in scan for scan in scans for channel in channels):
        colours = np.concatenate([np.column_stack([s[c] for c in channels]) for s in scans])
    return _columns(np.concatenate(points), colours)


def _not_installed(what: str, package: str) -> TargetError:
    return TargetError(
        f"cannot be read: {what} need the package {package}; install it with pip install "
        "'petalfit[formats]', or export the cloud as PLY."
    )


def _columns(points: np.ndarray, colours: np.ndarray | None) -> Columns:
    if colours is not None and not colours.any():
        colours = None  # Formats have a place for colours whether there are some or not.
    return {
        "points": np.asarray(points, np.float64),
        "normals": None,
        "weights": None,
        "colours": colours,
    }
