"""PCD files, those of the Point Cloud Library: ASCII, binary and compressed."""

from pathlib import Path

import numpy as np

from petalfit.observations.columns import Columns, named_columns
from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory

_KINDS = {"F": "f", "I": "i", "U": "u"}
_PACKED = ("rgb", "rgba")


def read_pcd(path: Path) -> Columns:
    """Reads a PCD file; points without a place, which depth cameras write, are NaN.

    Args:
        path: The path of the file.

    Raises:
        TargetError: The file is no PCD, or is cut short.
    """
    data = path.read_bytes()
    header: dict[str, list[str]] = {}
    position = 0
    while "DATA" not in header:
        end = data.find(b"\n", position, position + 65536)
        if end < 0:
            raise TargetError("is no PCD file or cut short: its header has no DATA; copy it again.")
        words = data[position:end].decode("ascii", "replace").partition("#")[0].split()
        header |= {words[0].upper(): words[1:]} if words else {}
        position = end + 1
    row, count = _row(header)
    body = data[position:]
    encoding = header["DATA"][0].lower() if header["DATA"] else ""
    if encoding == "ascii":
        return _named(_ascii_rows(body, row, count))
    if encoding == "binary":
        _check_length(len(body), row, count)
        return _named(np.frombuffer(body, row, count))
    if encoding == "binary_compressed":
        return _named(_compressed_rows(body, row, count))
    raise TargetError(f"is a PCD file with the data {encoding!r}; export it as ascii or binary.")


def _row(header: dict[str, list[str]]) -> tuple[np.dtype, int]:
    """The type of a row, and the number of rows."""
    try:
        names, sizes, kinds = header["FIELDS"], header["SIZE"], header["TYPE"]
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(names))]
        entries = [
            (f"{k} {name.lower()}", f"<{_KINDS[kind]}{int(size)}", (count,))
            for k, (name, size, kind, count) in enumerate(
                zip(names, sizes, kinds, counts, strict=True)
            )
        ]
        if "POINTS" in header:
            total = int(header["POINTS"][0])
        else:
            total = int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        row = np.dtype(entries)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise TargetError(
            f"is damaged: its header is incomplete or contradicts itself ({error}); export it again."
        ) from None
    if total < 1 or row.itemsize == 0:
        raise TargetError("holds no points; export it again.")
    return row, total


def _check_length(found: int, row: np.dtype, count: int) -> None:
    if found < count * row.itemsize:
        raise TargetError(
            f"is cut short: {count} points announced, {found // row.itemsize} found; copy it again."
        )


def _ascii_rows(body: bytes, row: np.dtype, count: int) -> np.ndarray:
    """The rows of a file whose data are text."""
    check_memory(30 * len(body))
    words = body.split()
    counts = {name: row[name].shape[0] for name in row.names or ()}
    width = sum(counts.values())
    if len(words) != count * width:
        raise TargetError(
            f"is damaged: {count} points of {width} numbers announced, {len(words)} numbers found; copy "
            "it again."
        )
    table = np.array([float(word) for word in words]).reshape(count, width)
    rows, column = np.empty(count, row), 0
    for name, wide in counts.items():
        with np.errstate(all="ignore"):
            rows[name] = table[:, column : column + wide]
        column += wide
    return rows


def _compressed_rows(body: bytes, row: np.dtype, count: int) -> np.ndarray:
    """The rows of a file whose data are compressed, one field after the other."""
    packed, size = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
    _check_length(size, row, count)
    check_memory(3 * size)
    content = _decompressed(body[8 : 8 + packed], size)
    rows, position = np.empty(count, row), 0
    for name in row.names or ():
        kind, shape = row[name].base, row[name].shape
        length = count * shape[0]
        rows[name] = np.frombuffer(content, kind, length, position).reshape(count, *shape)
        position += length * kind.itemsize
    return rows


def _decompressed(packed: bytes, size: int) -> bytes:
    """Undoes LZF, the compression of PCD: runs of literal bytes, and references to earlier ones."""
    found, k = bytearray(), 0
    try:
        while k < len(packed) and len(found) <= size:
            control = packed[k]
            k += 1
            if control < 32:
                found += packed[k : k + control + 1]
                k += control + 1
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += packed[k]
                k += 1
            start = len(found) - ((control & 31) << 8) - packed[k] - 1
            k += 1
            if start < 0:
                raise IndexError
            # A reference may reach into what it writes: the bytes before it are then repeated.
            source = found[start : start + length]
            found += (source * (length // max(len(source), 1) + 1))[:length]
    except IndexError:
        found.clear()
    if len(found) != size:
        raise TargetError(
            "is damaged or cut short: its data cannot be decompressed; copy it again."
        )
    return bytes(found)


def _named(rows: np.ndarray) -> Columns:
    """The columns of the fields, of which `rgb` packs three bytes in one number."""
    columns: dict[str, np.ndarray] = {}
    for key in rows.dtype.names or ():
        name, values = key.partition(" ")[2], rows[key].reshape(len(rows), -1).T
        if len(values) != 1:
            continue
        values = values[0]
        if name in _PACKED and values.dtype.itemsize == 4:
            bits = np.ascontiguousarray(values).view("<u4")
            for shift, channel in ((16, "red"), (8, "green"), (0, "blue")):
                columns[channel] = ((bits >> shift) & 255).astype(np.uint8)
        else:
            columns[name] = values
    return named_columns(columns)
