"""Tables of numbers as point clouds: the meaning of their columns, and delimited text."""

from array import array
from pathlib import Path
from typing import TypedDict

import numpy as np
from jaxtyping import Float64

from petalfit.observations.errors import TargetError

# Unit normals written with two decimals deviate from length 1 by up to 1 %; colours by far more.
UNIT_TOLERANCE = 0.05


class Columns(TypedDict):
    """The fields of a `PointCloud`, before they are checked."""

    points: np.ndarray
    normals: np.ndarray | None
    weights: np.ndarray | None
    colours: np.ndarray | None


def unnamed_columns(table: Float64[np.ndarray, "n k"]) -> Columns:
    """Reads the columns of a table without column names by their position.

    Args:
        table: (N, k), k ≥ 3. The first three columns are x, y, z. Three more are a normal if they
            have unit length in every row (or are all zero, for unknown); otherwise they are taken
            for a colour and ignored, as is any other number of further columns.

    Returns:
        points (N, 3) and normals (N, 3) or None; no weights.
    """
    normals = None
    if table.shape[1] == 6:
        length = np.linalg.norm(table[:, 3:], axis=1)
        if length.any() and (np.abs(length[length != 0.0] - 1.0) < UNIT_TOLERANCE).all():
            normals = table[:, 3:]
    return {"points": table[:, :3], "normals": normals, "weights": None, "colours": None}


def named_columns(table: Float64[np.ndarray, "n k"], names: list[str]) -> Columns:
    """Reads the columns of a table by their names.

    Args:
        table: The table, (N, k).
        names: k names in lower case: x, y, z; optionally nx, ny, nz, weight (or weights), and red,
            green, blue (or r, g, b), from 0 to 1 or from 0 to 255. Other columns are ignored.

    Returns:
        points (N, 3), normals (N, 3) or None, weights (N,) or None and colours (N, 3) or None.
    """
    column = dict(zip(names, table.T, strict=True))
    has_normals = {"nx", "ny", "nz"} <= column.keys()
    return {
        "points": np.column_stack([column[name] for name in ("x", "y", "z")]),
        "normals": np.column_stack([column[f"n{axis}"] for axis in "xyz"]) if has_normals else None,
        "weights": column.get("weight", column.get("weights")),
        "colours": _colours(column),
    }


def _colours(column: dict[str, Float64[np.ndarray, " n"]]) -> Float64[np.ndarray, "n 3"] | None:
    """The colours of a table, scaled to 0 to 1 if the table counts to 255."""
    for names in ("red", "green", "blue"), ("r", "g", "b"):
        if set(names) <= column.keys():
            colours = np.column_stack([column[name] for name in names])
            return colours / 255 if (colours > 1).any() else colours
    return None


def read_text(path: Path) -> Columns:
    """Reads delimited text: one point per line, its numbers between commas, semicolons or white space.

    Between semicolons a comma is a decimal point, as spreadsheets write it in half of Europe. A #
    begins a comment. The first line may be a header. If a header names x, y and z (it may then also be
    a comment that begins with these names), columns are identified by name (`named_columns`), otherwise
    by position (`unnamed_columns`).

    Args:
        path: The path of the file. Bytes that are not UTF-8 are replaced.

    Returns:
        The columns.

    Raises:
        TargetError: A line does not consist of numbers or has another number of columns than the lines
            before it, or there are no points.
    """
    values, width, names = array("d"), 0, None
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            if not values and names is None and (names := _header(line)) is not None:
                continue
            fields = _fields(line.partition("#")[0])
            if not fields:
                continue
            width = width or len(fields)
            if len(fields) != width:
                complaint = f"another number of columns ({len(fields)}) than before it ({width})"
                raise _line_error(number, line, complaint)
            if width < 3:
                raise _line_error(number, line, f"too few columns ({width}) for x, y and z")
            try:
                values.extend(map(float, fields))
            except ValueError:
                word = next(field for field in fields if not _is_number(field))
                raise _line_error(number, line, f"{_shown(word)} for a number") from None
    if not values:
        raise TargetError("holds no points, expected lines of at least three numbers.")
    table = np.frombuffer(values).reshape(-1, width)
    if names is None or not {"x", "y", "z"} <= set(names):
        return unnamed_columns(table)
    if len(names) != width:
        raise TargetError(f"has {len(names)} names in its header, but {width} columns of numbers.")
    return named_columns(table, names)


def _header(line: str) -> list[str] | None:
    """The column names in a line, in lower case, or None if the line is not a header."""
    # CloudCompare begins its header with //.
    names = [name.strip("\"' \t\n\r").lower() for name in _fields(line.lstrip("#/ \t"))]
    if names[:3] == ["x", "y", "z"]:
        return names
    if not names or line.lstrip().startswith("#") or any(map(_is_number, names)):
        return None
    return names


def _fields(text: str) -> list[str]:
    """The fields of a line; one delimiter at its end is allowed."""
    text = text.strip()
    if ";" in text:
        return text.removesuffix(";").replace(",", ".").split(";")
    if "," in text:
        return text.removesuffix(",").split(",")
    return text.split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _line_error(number: int, line: str, complaint: str) -> TargetError:
    """The error for an invalid line of a file."""
    return TargetError(
        f"line {number} has {complaint}: {_shown(line)}; correct it, or comment it out with #."
    )


def _shown(text: str) -> str:
    """Text in quotes, cut to 60 characters."""
    text = text.strip()
    return repr(text) if len(text) <= 60 else f"{text[:60]!r}…"
