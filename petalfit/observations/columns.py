"""Tables of numbers as point clouds: which column is which, by its name or by its position."""

import re
from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict

import numpy as np
from jaxtyping import Float64, Num

from petalfit.observations.errors import TargetError

# Unit normals written with two decimals deviate from length 1 by up to 1 %; colours by far more.
UNIT_TOLERANCE = 0.05
# Fewer rows may count upwards in their first column by chance.
_FEWEST_COUNTED = 10

# A unit at the end of a name: in brackets, or after a gap. Other words in brackets are no unit.
_UNITS = "nm|µm|μm|um|mm|cm|dm|m|km|in|inch|inches|ft|feet|px|pixels"
_UNIT = re.compile(rf"\s*[\[(<]\s*(?:({_UNITS})|[^\])>]*)\s*[\])>]|[\s_.\-]+({_UNITS})")
# The names of columns, in lower case and without unit. The group that matches is the axis or channel.
_GAP = r"[\s_:.\-]"
_PLACE = "(?:coords?|coordinates?|pos|positions?|points?|vertex|vertices|xyz|location)"
_POINT = re.compile(
    rf"(?:{_PLACE}{_GAP}*)?([xyz])(?:{_GAP}*(?:coord|coordinate|pos|position))?|{_PLACE}{_GAP}+([012])"
)
_NORMAL = re.compile(rf"(?:n|normals?){_GAP}*([xyz])|normals?{_GAP}+([012])")
_COLOUR = re.compile(
    rf"(?:(?:colou?rs?|rgba?|diffuse){_GAP}*)?(r|g|b|red|green|blue)|(?:colou?rs?|rgba?){_GAP}+([012])"
)
_EAST_NORTH_UP = {
    "east": "x",
    "easting": "x",
    "north": "y",
    "northing": "y",
    "up": "z",
    "elevation": "z",
}
_AXES = {"x": "x", "y": "y", "z": "z", "0": "x", "1": "y", "2": "z"}
_CHANNELS = {"r": "red", "g": "green", "b": "blue", "0": "red", "1": "green", "2": "blue"}
KNOWN_NAMES = (
    'x, y and z, as in "x", "X [mm]", "x_mm", "coord_x" or "Points:0", or easting, northing and up'
)


class Columns(TypedDict):
    """The fields of a `PointCloud`, before they are checked, with notes on what was done to them."""

    points: np.ndarray
    normals: np.ndarray | None
    weights: np.ndarray | None
    colours: np.ndarray | None
    notes: NotRequired[tuple[str, ...]]


def unnamed_columns(table: Float64[np.ndarray, "n k"]) -> Columns:
    """Reads the columns of a table without column names by their position.

    The first three columns are x, y, z. Three more are a normal if they have unit length in every row
    (or are zero, for unknown); otherwise they are taken for a colour and left out, as is any other
    number of further columns. A first column that numbers the rows is left out.

    Args:
        table: (N, k), k ≥ 3.

    Returns:
        points (N, 3) and normals (N, 3) or None; no weights.

    Raises:
        TargetError: The first column may as well be a number or a class of the point as its x.
    """
    notes: tuple[str, ...] = ()
    normals = _normals(table)
    # Three columns before a normal are x, y and z without a doubt.
    if normals is None and _counts(table[:, 0]):
        if table.shape[1] == 3:
            raise TargetError(
                "has three columns without names, of which the first one numbers the rows; two are left "
                "for x, y and z. Add the missing one."
            )
        table = table[:, 1:]
        normals = _normals(table)
        notes = ("the first column numbers the points, and was left out",)
    elif normals is None and table.shape[1] > 3:
        whole = [bool((column == np.rint(column)).all()) for column in table[:, :3].T]
        if whole == [True, False, False]:
            raise TargetError(
                f"has {table.shape[1]} columns without names. The first one holds whole numbers and the "
                "next two do not: it may be x, or a number or a class of the point. Name the columns in "
                "the first line, for instance: id x y z."
            )
    return {
        "points": table[:, :3],
        "normals": normals,
        "weights": None,
        "colours": None,
        "notes": notes,
    }


def _normals(table: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "n 3"] | None:
    """The last three of six columns, if they are unit vectors, or zero for unknown ones."""
    if table.shape[1] != 6:
        return None
    length = np.linalg.norm(table[:, 3:], axis=1)
    unit = np.abs(length[length != 0.0] - 1.0) < UNIT_TOLERANCE
    return table[:, 3:] if len(unit) and unit.all() else None


def _counts(column: Float64[np.ndarray, " n"]) -> bool:
    """Whether a column counts its rows, from 0 or from 1."""
    if len(column) < _FEWEST_COUNTED or column[0] not in (0.0, 1.0):
        return False
    return bool((column == column[0] + np.arange(len(column))).all())


def understood(names: Sequence[str]) -> dict[str, int]:
    """Which column is which, by its name.

    Names may be quoted and in any case. What is taken for the coordinates is:

    - `x`, `y`, `z`, with a unit (`x [mm]`, `X (m)`, `x_mm`), with a word for place before or after them
      (`coord_x`, `pos.x`, `Points:0`, `Points_0`, `point_x`, `x_coordinate`), or `easting`, `northing`
      and `up` or `elevation`.
    - Normals are `nx`, `normal_x` or `Normals:0`; the weight is `weight` or `weights`.
    - Colours are `red`, `r`, `color_r`, `diffuse_red` or `RGB:0`, and so on.

    A plain name comes before the others: with `x` and `x_coordinate`, `x` is taken.

    Args:
        names: The names of the columns.

    Returns:
        The positions of the columns by their plain names: x, y, z, nx, ny, nz, weight, red, green, blue.
        Names that are not understood are left out.

    Raises:
        TargetError: Two columns may be the same coordinate, or coordinates have different units.
    """
    candidates: dict[str, list[tuple[int, str | None]]] = {}
    for position, name in enumerate(names):
        meaning, unit = _meaning(name)
        if meaning is not None:
            candidates.setdefault(meaning, []).append((position, unit))
    found, units = {}, set()
    for meaning, places in candidates.items():
        plain = [place for place in places if _plain(names[place[0]]) == meaning]
        if len(plain or places) > 1 and meaning in ("x", "y", "z"):
            twice = ", ".join(repr(names[position]) for position, _ in plain or places)
            raise TargetError(f"has several columns for {meaning} ({twice}); keep one of them.")
        found[meaning], unit = (plain or places)[0]
        if meaning in ("x", "y", "z"):
            units.add(unit)
    if len(units - {None}) > 1:
        raise TargetError(
            f"has coordinates in different units ({', '.join(sorted(units - {None}))}); convert them "
            "to one."
        )
    return found


def _plain(name: str) -> str:
    return name.strip("\"' \t\r\n#/\ufeff").lower()


def _meaning(name: str) -> tuple[str | None, str | None]:
    """The plain name of a column, and the unit that its name gives; None for what is not there."""
    name, unit = _plain(name), None
    ending = next((match for match in _UNIT.finditer(name) if match.end() == len(name)), None)
    if ending and ending.start():
        name, unit = name[: ending.start()], ending[1] or ending[2]
    if name in _EAST_NORTH_UP:
        return _EAST_NORTH_UP[name], unit
    if name in ("weight", "weights"):
        return "weight", None
    if match := _POINT.fullmatch(name):
        return _AXES[match[1] or match[2]], unit
    if match := _NORMAL.fullmatch(name):
        return f"n{_AXES[match[1] or match[2]]}", None
    if match := _COLOUR.fullmatch(name):
        return _CHANNELS.get(match[1] or match[2], match[1]), None
    return None, None


def without_coordinates(names: Sequence[str]) -> TargetError:
    """The error for columns of which none, or too few, are understood as coordinates."""
    shown = ", ".join(repr(name.strip()[:30]) for name in names[:8]) + (
        ", …" if len(names) > 8 else ""
    )
    return TargetError(
        f"has columns of which x, y and z are not known by their names ({shown}); expected "
        f"{KNOWN_NAMES}. Rename them."
    )


def named_columns(column: Mapping[str, Num[np.ndarray, " n"]]) -> Columns:
    """Reads the columns of a table by their names, see `understood`.

    Args:
        column: The columns by name. Those that are not understood are ignored.

    Returns:
        points (N, 3) in float64, and the normals (N, 3), weights (N,) and colours (N, 3) as they are, or
        None.

    Raises:
        TargetError: There are no coordinates among the names.
    """
    names = list(column)
    place = {meaning: names[position] for meaning, position in understood(names).items()}
    if not {"x", "y", "z"} <= place.keys():
        raise without_coordinates(names)

    def stacked(*meanings: str) -> np.ndarray | None:
        if not place.keys() >= {*meanings}:
            return None
        return np.column_stack([column[place[meaning]] for meaning in meanings])

    points = np.empty((len(column[place["x"]]), 3))
    for axis, meaning in enumerate("xyz"):
        points[:, axis] = column[place[meaning]]
    return {
        "points": points,
        "normals": stacked("nx", "ny", "nz"),
        "weights": column[place["weight"]] if "weight" in place else None,
        "colours": stacked("red", "green", "blue"),
    }
