"""The files of surveys: LAS, LAZ and E57. Their readers are installed with `petalfit[formats]`."""

import struct
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from petalfit.observations.columns import Columns
from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory

if TYPE_CHECKING:
    import laspy

_BYTES_A_POINT = 200
# The length of the longest header of LAS, and the least lengths of its records.
_LAS_HEADER, _RECORD, _EXTENDED_RECORD = 375, 54, 60
# A compressed chunk begins with a whole point, which takes at least this many bytes.
_CHUNK = 20


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

    size = path.stat().st_size
    with path.open("rb") as opened:
        _check_records(opened.read(_LAS_HEADER), size)
        opened.seek(0)
        # Not the parallel decompressor: it trusts the lengths in a damaged file, and ends the process.
        backend = laspy.LazBackend.Lazrs
        with laspy.open(opened, closefd=False, laz_backend=backend) as file:
            if file.header.are_points_compressed:
                _check_chunks(opened, file.header.offset_to_point_data, size)
            return _las_columns(file, size)


def _check_records(header: bytes, size: int) -> None:
    """Raises an error for records that the file is too short for; laspy would look for all of them."""
    if header[:4] != b"LASF":
        raise TargetError("is no LAS or LAZ file: it does not begin with LASF; export it again.")
    if len(header) < 104:
        raise TargetError("is cut short: its header is not complete; copy it again.")
    start, points, count = struct.unpack_from("<HII", header, 94)
    end = start + _RECORD * count
    if header[25] >= 4 and len(header) >= 247:
        after, extended = struct.unpack_from("<QI", header, 235)
        end = max(end, after + _EXTENDED_RECORD * extended if extended else 0)
    if end > size or points > size:
        raise TargetError("is damaged or cut short: its records end after the file; copy it again.")


def _check_chunks(file: BinaryIO, start: int, size: int) -> None:
    """Raises an error for a table of more compressed chunks than the file can hold."""
    place = file.tell()
    file.seek(start)
    (table,) = struct.unpack("<q", file.read(8))
    if table == -1:  # The table was written last, and its place after it.
        file.seek(-8, 2)
        (table,) = struct.unpack("<q", file.read(8))
    file.seek(max(table, 0) + 4)
    (chunks,) = struct.unpack("<I", file.read(4))
    file.seek(place)
    if chunks * _CHUNK > size:
        raise TargetError("is damaged or cut short: its chunks are longer than it; copy it again.")


def _las_columns(file: "laspy.LasReader", size: int) -> Columns:
    """The points of an open file of some size."""
    header = file.header
    if header.point_count == 0:
        raise TargetError("holds no points; export it again.")
    found = size // max(header.point_format.size, 1)
    if not header.are_points_compressed and found < header.point_count:
        raise TargetError(
            f"is cut short: {header.point_count} points announced, at most {found} found; copy it again."
        )
    check_memory(_BYTES_A_POINT * header.point_count)
    points = file.read()
    names = {*points.point_format.dimension_names}
    colours = None
    if {"red", "green", "blue"} <= names:
        colours = np.array([points.red, points.green, points.blue]).T
    return _columns(np.array([points.x, points.y, points.z]).T, colours)


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
