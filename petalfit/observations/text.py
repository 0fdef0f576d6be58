"""Delimited text as a point cloud: XYZ, TXT, ASC, PTS and CSV."""

import csv
import re
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from petalfit.observations.columns import (
    Columns,
    named_columns,
    understood,
    unnamed_columns,
    without_coordinates,
)
from petalfit.observations.errors import TargetError

# The longest marks come first: UTF-32's begins with UTF-16's.
_BYTE_ORDER_MARKS = {
    b"\xff\xfe\0\0": "utf-32",
    b"\0\0\xfe\xff": "utf-32",
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
}
_DECIMAL_COMMA = re.compile(r"[+-]?\d+(?:,\d+)?(?:[eE][+-]?\d+)?")
_COMMENTS = ("#", "//", "%")
_MISSING = ("na", "n/a", "null")
_LONGEST_LINE = 1_000_000


def read_text(path: Path) -> Columns:
    """Reads delimited text: one point per line, its numbers between commas, semicolons or white space.

    - Between semicolons, tabs or blanks a comma between digits is a decimal point, as spreadsheets write
      it in half of Europe.
    - #, // and % begin a comment. A line with one whole number before the points is their number, as in
      PTS files and those of CloudCompare.
    - The first line may be a header. Its names say which column is which (`columns.understood`); a
      header without x, y and z is refused. A comment that names x, y and z is a header too. Without one,
      columns are identified by position (`columns.unnamed_columns`).
    - Names of rows, as R writes them, are left out. NA is a missing number.
    - A byte order mark gives the encoding. Without one it is UTF-8, and other bytes are replaced.

    Args:
        path: The path of the file.

    Returns:
        The columns.

    Raises:
        TargetError: A line does not consist of numbers or has another number of columns than the lines
            before it, the names are not understood, or there are not as many points as announced.
    """
    with path.open("rb") as file:
        encoding = _encoding(file.read(4))
    with path.open(encoding=encoding, errors="replace") as file:
        return _Table().read(enumerate(iter(lambda: file.readline(_LONGEST_LINE), ""), start=1))


def _encoding(start: bytes) -> str:
    """The encoding of a file that begins with these four bytes."""
    for mark, name in _BYTE_ORDER_MARKS.items():
        if start.startswith(mark):
            return name
    # Digits and letters in UTF-16 have a zero as their other byte.
    if start[1::2] == b"\0\0" and start[0]:
        return "utf-16-le"
    return "utf-16-be" if start[::2] == b"\0\0" and start[1] else "utf-8-sig"


class _Table:
    """The numbers that have been read so far, and what is known about their columns."""

    def __init__(self) -> None:
        self.names: list[str] | None = None
        self.is_comment = False  # whether the names stand in a comment
        self.announced: int | None = None
        self.width = 0
        self.used: list[int] = []  # the columns that are kept
        self.delimiter: str | None = None  # that of the last line; None for white space
        self.values = array("d")

    def read(self, lines: Iterator[tuple[int, str]]) -> Columns:
        """Reads all lines, which come with their numbers."""
        for number, line in lines:
            if self._is_like_the_last(line):
                continue
            if not self.width and ("\0" in line or len(line) == _LONGEST_LINE):
                raise TargetError(
                    f"is no text: line {number} has zero bytes or no end; export the cloud as text, or "
                    "give the file the suffix of its format."
                )
            if not self.width and self.names is None and self._is_header(line):
                continue
            text = line.partition("#")[0].strip()
            if not text or text.startswith(_COMMENTS):
                continue
            self.delimiter = _delimiter(text)
            fields = _fields(text, self.delimiter)
            if len(fields) == 1 and fields[0].isdecimal() and self._expects_count():
                self.announced = (self.announced or 0) + int(fields[0][:18])
                continue
            if not self.width:
                self._first(number, line, fields)
            if len(fields) != self.width:
                raise _line_error(
                    number,
                    line,
                    f"another number of columns ({len(fields)}) than before it ({self.width})",
                )
            try:
                self.values.extend([float(fields[k]) for k in self.used])
            except ValueError:
                self.values.extend(_numbers([fields[k] for k in self.used], number, line))
        return self._columns()

    def _is_like_the_last(self, line: str) -> bool:
        """Whether a line consists of as many numbers as the last one; if it does, they are kept."""
        fields = line.split(self.delimiter)
        if not self.width or len(fields) != self.width:
            return False
        try:
            self.values.extend([float(fields[k]) for k in self.used])
        except ValueError:
            return False
        return True

    def _is_header(self, line: str) -> bool:
        """Whether a line is a header; if it is, it is kept."""
        text = line.strip()
        is_comment = text.startswith(_COMMENTS)
        text = text.lstrip("#/% \t")
        names = _fields(text, _delimiter(text))
        if not names or any(map(_is_number, filter(None, names))):
            return False
        if is_comment and not {"x", "y", "z"} <= understood(names).keys():
            return False
        if not is_comment and not any(names):
            return False
        self.names, self.is_comment = names, is_comment
        return True

    def _expects_count(self) -> bool:
        """Whether a line with a single whole number may be the number of points that follow."""
        return not self.width or self.announced == len(self.values) // len(self.used)

    def _first(self, number: int, line: str, fields: list[str]) -> None:
        """Finds out from the first line of numbers which columns are kept."""
        self.width = len(fields)
        self.used = list(range(self.width))
        if self.names is None:
            if self.width > 3 and line.lstrip().startswith('"'):  # the name of a row
                self.used = self.used[1:]
        else:
            self._name(fields)
        if len(self.used) < 3:
            raise _line_error(number, line, f"too few columns ({len(self.used)}) for x, y and z")

    def _name(self, fields: list[str]) -> None:
        """Brings the names together with as many columns as there are."""
        names = self.names or []
        known = understood(names)
        if not {"x", "y", "z"} <= known.keys():
            raise without_coordinates(names)
        if len(names) == self.width - 1 and (
            not _is_number(fields[0])
            or (fields[0] == "1" and not all(field.isdecimal() for field in fields))
        ):
            names = ["", *names]  # R gives the names of rows no name.
        elif len(names) > self.width:
            # The last names may consist of several words, as in CloudCompare's "Scalar field".
            leading = next(k for k in range(len(names) + 1) if k not in known.values())
            if leading < self.width and max(known.values()) < leading:
                names = names[:leading] + [""] * (self.width - leading)
        if len(names) != self.width:
            if self.is_comment:
                self.names = None
                return
            raise TargetError(
                f"has {len(names)} names in its header, but {self.width} columns of numbers."
            )
        found = understood(names)
        self.used = sorted(found.values())
        self.names = [names[k] for k in self.used]

    def _columns(self) -> Columns:
        if not self.values:
            raise TargetError("holds no points, expected lines of at least three numbers.")
        table = np.frombuffer(self.values).reshape(-1, len(self.used))
        if self.announced is not None and self.announced != len(table):
            raise TargetError(
                f"announces {self.announced} points, but holds {len(table)}; it is cut short, or the "
                "line with this number is none of their number. Copy it again, or take the line out."
            )
        if self.names is not None:
            return named_columns(dict(zip(self.names, table.T, strict=True)))
        if (
            len(table) > 1
            and (table[0] == np.arange(len(table[0]))).all()
            and (table[1:] % 1).any()
        ):
            # A table of pandas whose columns have no names has their numbers for a header.
            columns = unnamed_columns(table[1:])
            note = "the first line numbers the columns, and was left out"
            return {**columns, "notes": (note, *columns.get("notes", ()))}
        return unnamed_columns(table)


def _delimiter(text: str) -> str | None:
    """What separates the fields of a line; None for white space."""
    delimiter = next((mark for mark in ";\t," if mark in text), None)
    if delimiter == "\t" and all(x.endswith(",") for x in text.split("\t")[:-1]):
        return ","
    if delimiter == "," and _has_decimal_commas(text.split()):
        return None
    return delimiter


def _fields(text: str, delimiter: str | None) -> list[str]:
    """The fields of a line; one delimiter at its end is allowed."""
    if '"' in text:
        row = next(csv.reader([text], delimiter=delimiter or " ", skipinitialspace=True), [])
        fields = [field.strip() for field in row]
        if delimiter is None:
            fields = [field for field in fields if field]
    else:
        fields = [field.strip() for field in text.split(delimiter)]
    return fields[:-1] if len(fields) > 1 and not fields[-1] and delimiter else fields


def _has_decimal_commas(fields: list[str]) -> bool:
    """Whether at least three fields, with a comma among them, are numbers with decimal commas."""
    return len(fields) >= 3 and all(_DECIMAL_COMMA.fullmatch(x.strip()) for x in fields)


def _numbers(fields: list[str], number: int, line: str) -> list[float]:
    """The numbers of fields that Python does not read at once: with decimal commas, or missing."""
    values = []
    for field in fields:
        try:
            if field.lower() in _MISSING:
                values.append(np.nan)
            elif _DECIMAL_COMMA.fullmatch(field):
                values.append(float(field.replace(",", ".")))
            else:
                values.append(float(field))
        except ValueError:
            raise _line_error(number, line, f"{_shown(field)} for a number") from None
    return values


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return bool(_DECIMAL_COMMA.fullmatch(text))
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
