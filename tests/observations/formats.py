"""Small files of every format, made from points, for the tests of readers."""

import struct
from pathlib import Path

import numpy as np


def text_of(*tables: np.ndarray, delimiter: str = " ") -> str:
    rows = np.column_stack(tables).tolist()
    return "".join(delimiter.join(map(repr, row)) + "\n" for row in rows)


def ply_of(points: np.ndarray, properties: str, rows: bytes, rest: str = "") -> bytes:
    """A binary PLY of little endian rows, with more lines of its header."""
    lines = [f"property {entry}" for entry in properties.split(", ")]
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(points)}",
        *lines,
        *filter(None, [rest]),
        "end_header\n",
    ]
    return "\n".join(head).encode() + rows


def pcd_of(points: np.ndarray, encoding: str, colour: int | None = None) -> bytes:
    """A PCD file of x, y, z as float and, if there is a colour, rgb."""
    n, fields = len(points), ["x", "y", "z"]
    kinds = [(name, "<f4") for name in fields]
    if colour is not None:
        fields, kinds = [*fields, "rgb"], [*kinds, ("rgb", "<u4")]
    rows = np.empty(n, kinds)
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    if colour is not None:
        rows["rgb"] = colour
    header = [
        "# .PCD v0.7",
        "VERSION 0.7",
        f"FIELDS {' '.join(fields)}",
        f"SIZE {' '.join('4' for _ in fields)}",
        f"TYPE {' '.join('U' if name == 'rgb' else 'F' for name in fields)}",
        f"COUNT {' '.join('1' for _ in fields)}",
        f"WIDTH {n}",
        "HEIGHT 1",
        f"POINTS {n}",
        f"DATA {encoding}\n",
    ]
    if encoding == "ascii":
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows.tolist()).encode()
    elif encoding == "binary":
        body = rows.tobytes()
    else:
        plain = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in fields)
        packed = lzf(plain)
        body = struct.pack("<II", len(packed), len(plain)) + packed
    return "\n".join(header).encode() + body


def lzf(data: bytes) -> bytes:
    """LZF that uses a reference wherever the last four bytes repeat, as in a column of one colour."""
    packed, literal, k = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literal), 32):
            part = literal[start : start + 32]
            packed.extend([len(part) - 1, *part])
        literal.clear()

    while k < len(data):
        length = 0
        while (
            4 <= k < len(data) - length
            and length < 264
            and data[k + length] == data[k + length - 4]
        ):
            length += 1
        if length < 3:
            literal.append(data[k])
            k += 1
            continue
        flush()
        coded = length - 2
        packed.extend([coded << 5, 3] if coded < 7 else [7 << 5, coded - 7, 3])
        k += length
    flush()
    return bytes(packed)


def las_of(points: np.ndarray, path: Path, colours: np.ndarray | None = None) -> Path:
    """A LAS or LAZ file with steps of 1e-6."""
    import laspy

    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, 1e-6)
    header.offsets = points.min(axis=0)
    file = laspy.LasData(header)
    file.x, file.y, file.z = points.T
    if colours is not None:
        file.red, file.green, file.blue = colours.T
    file.write(path)
    return path


def e57_of(scans: list[np.ndarray], path: Path, shift: np.ndarray | None = None) -> Path:
    """An E57 file, of which every scan is moved by `shift` when it is read."""
    import pye57

    with pye57.E57(str(path), mode="w") as file:
        for points in scans:
            columns = {f"cartesian{axis}": points[:, k] for k, axis in enumerate("XYZ")}
            file.write_scan_raw(columns, rotation=np.array([1.0, 0.0, 0.0, 0.0]), translation=shift)
    return path
