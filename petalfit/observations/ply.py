"""PLY files: the vertices with all their properties, and the faces as triangles."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64, Int64, Num

from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_FORMATS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1_000_000
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class _Property:
    name: str
    kind: np.dtype
    counted_by: np.dtype | None  # the type of a list's length


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(path: Path) -> tuple[dict[str, np.ndarray], Int64[np.ndarray, "f 3"] | None]:
    """Reads the vertices and the faces of a PLY file, ASCII or binary.

    Args:
        path: The path of the file.

    Returns:
        The properties of the vertices that are no lists, by their names and in their own types, (V,)
        each; and the corners of the triangles, (F, 3), or None if there are no faces. Polygons are
        divided into triangles about their first corner.

    Raises:
        TargetError: The file is no PLY, or is cut short.
    """
    with path.open("rb") as file:
        order, elements, start = _header(file)
    content = path.read_bytes()
    if order == "=":
        body = _ascii(content[start:])
        position = 0
    else:
        body, position = np.frombuffer(content, np.uint8), start
    vertices: dict[str, np.ndarray] = {}
    faces = None
    for element in elements:
        rows = _Rows(body, position, element, order)
        if element.name == "vertex":
            vertices = rows.scalars()
        elif element.name == "face":
            for index, entry in enumerate(element.properties):
                if entry.name in _CORNERS and entry.counted_by is not None:
                    faces = rows.triangles(index)
        position = rows.end
    if order == "=" and position != len(body):
        raise TargetError(
            f"is damaged: its header announces {position} numbers, and {len(body)} are found; copy it "
            "again."
        )
    return vertices, faces if faces is not None and len(faces) else None


def _header(file: BinaryIO) -> tuple[str, list[_Element], int]:
    """The byte order ("=" for ASCII), the elements, and where they begin."""
    if file.readline(8).strip() != b"ply":
        raise TargetError("is no PLY file: it does not begin with ply; export it again.")
    order, elements = None, []
    while True:
        line = file.readline(4096)
        if not line or file.tell() > _LONGEST_HEADER:
            raise TargetError("is damaged or cut short: its header has no end; copy it again.")
        words = line.decode("ascii", "replace").split()
        try:
            match words:
                case ["end_header"]:
                    break
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, *_]:
                    order = _FORMATS[name]
                case ["element", name, count]:
                    elements.append(_Element(name, _size(count)))
                case ["property", "list", counted_by, kind, name]:
                    types = _type(kind, order), _type(counted_by, order)
                    elements[-1].properties.append(_Property(name, *types))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _type(kind, order), None))
                case _:
                    raise ValueError
        except (KeyError, IndexError, ValueError):
            shown = line.decode("ascii", "replace").strip()[:60]
            raise TargetError(
                f"is damaged: its header has the line {shown!r}; export it again."
            ) from None
    if order is None:
        raise TargetError("is damaged: its header names no format; export it again.")
    return order, elements, file.tell()


def _size(text: str) -> int:
    if not text.isdecimal():
        raise ValueError
    return int(text[:20])


def _type(name: str, order: str | None) -> np.dtype:
    return np.dtype((order or "=") + _TYPES[name])


def _ascii(text: bytes) -> Float64[np.ndarray, " w"]:
    """All numbers of a file, in their order."""
    # Two bytes are the shortest number; the text is there twice, as bytes and as a string.
    check_memory(6 * len(text))
    with warnings.catch_warnings():
        # np.fromstring drops what it cannot parse.
        warnings.filterwarnings("error", "string or file could not be read to its end")
        try:
            return np.fromstring(text.decode("ascii"), np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            raise TargetError(
                "is damaged: not all that follows its header are numbers; copy it again."
            ) from None


class _Rows:
    """The rows of one element, in an array of bytes (binary) or of numbers (ASCII).

    Attributes:
        end: The position of the first number after the rows.
    """

    def __init__(
        self, body: Num[np.ndarray, " w"], start: int, element: _Element, order: str
    ) -> None:
        self.body, self.element, self.is_ascii = body, element, order == "="
        self.start, count = start, element.count
        properties = element.properties
        # For each list: its index, and the widths of all before it, of its length, and of its items.
        self.lists: list[tuple[int, int, int, int]] = []
        self.tail = 0  # the width of what follows the last list
        for index, entry in enumerate(properties):
            if entry.counted_by is None:
                self.tail += self._width(entry.kind)
            else:
                widths = self._width(entry.counted_by), self._width(entry.kind)
                self.lists.append((index, self.tail, *widths))
                self.tail = 0
        least = self.tail + sum(before + counted for _, before, counted, _ in self.lists)
        found = (len(body) - start) // least if least else count
        if found < count:
            raise TargetError(
                f"is cut short: {count} {_plural(element.name)} announced, {found} found; copy it again."
            )
        if self.lists:
            # Where the length of each list stands, and how long it is.
            self.places, self.lengths, self.end = self._walk()
        else:
            self.end = start + count * least
        if self.end > len(body):
            raise self._cut_short()

    def _width(self, kind: np.dtype) -> int:
        return 1 if self.is_ascii else kind.itemsize

    def _walk(self) -> tuple[Int64[np.ndarray, "l n"], Int64[np.ndarray, "l n"], int]:
        """Where the lists are, how long they are, and where the rows end."""
        count = self.element.count
        if not count:
            return (
                np.empty((len(self.lists), 0), int),
                np.empty((len(self.lists), 0), int),
                self.start,
            )
        places, lengths, end = self._row(self.start)
        stride = end - self.start
        # Mostly all rows are alike.
        if self.start + count * stride <= len(self.body):
            every = np.array(places)[:, None] + stride * np.arange(count)
            alike = [
                (self.take(every[k], self._counted_by(index)) == lengths[k]).all()
                for k, (index, *_) in enumerate(self.lists)
            ]
            if all(alike):
                rows = np.repeat(np.array(lengths)[:, None], count, axis=1)
                return every, rows, self.start + count * stride
        all_places, all_lengths, position = [], [], self.start
        for _ in range(count):
            places, lengths, position = self._row(position)
            all_places.append(places)
            all_lengths.append(lengths)
        return np.array(all_places).T, np.array(all_lengths).T, position

    def _row(self, position: int) -> tuple[list[int], list[int], int]:
        """The places and lengths of the lists of one row, and where it ends."""
        places, lengths = [], []
        for index, before, counted, width in self.lists:
            position += before
            stop = position + counted
            if stop > len(self.body):
                raise self._cut_short()
            kind = self._counted_by(index)
            length = int(
                self.body[position] if self.is_ascii else self.body[position:stop].view(kind)[0]
            )
            places.append(position)
            lengths.append(length)
            position = stop + length * width
            if length < 0 or position > len(self.body):
                raise self._cut_short()
        return places, lengths, position + self.tail

    def _counted_by(self, index: int) -> np.dtype:
        kind = self.element.properties[index].counted_by
        assert kind is not None
        return kind

    def _cut_short(self) -> TargetError:
        return TargetError(
            f"is damaged or cut short: its {_plural(self.element.name)} are longer than the file; copy "
            "it again."
        )

    def take(self, places: Int64[np.ndarray, "..."], kind: np.dtype) -> Num[np.ndarray, "..."]:
        """The numbers of one type at some positions."""
        if self.is_ascii:
            return self.body[places]
        gathered = np.empty((*places.shape, kind.itemsize), np.uint8)
        for byte in range(kind.itemsize):
            gathered[..., byte] = self.body[places + byte]
        return gathered.view(kind)[..., 0]

    def scalars(self) -> dict[str, np.ndarray]:
        """The properties that are no lists, by their names in lower case."""
        properties, count = self.element.properties, self.element.count
        found: dict[str, np.ndarray] = {}
        if not self.lists and not self.is_ascii:
            row = np.dtype([(str(k), entry.kind) for k, entry in enumerate(properties)])
            rows = np.frombuffer(self.body, row, count, self.start) if properties else {}
            return {entry.name.lower(): rows[str(k)] for k, entry in enumerate(properties)}
        if not self.lists:
            table = self.body[self.start : self.end].reshape(count, len(properties))
            return {
                entry.name.lower(): _declared(table[:, k], entry.kind)
                for k, entry in enumerate(properties)
            }
        # The properties before a list are found from its place, those after the last one from its end.
        for index, entry in enumerate(properties):
            if entry.counted_by is not None:
                continue
            following = next((k for k, (at, *_) in enumerate(self.lists) if at > index), None)
            if following is not None:
                at = self.lists[following][0]
                between = sum(self._width(p.kind) for p in properties[index:at])
                places = self.places[following] - between
            else:
                at, _, counted, width = self.lists[-1]
                between = sum(self._width(p.kind) for p in properties[at + 1 : index])
                places = self.places[-1] + counted + self.lengths[-1] * width + between
            found[entry.name.lower()] = _declared(self.take(places, entry.kind), entry.kind)
        return found

    def triangles(self, index: int) -> Int64[np.ndarray, "f 3"]:
        """The triangles that the polygons in one of the lists consist of."""
        k = next(k for k, (at, *_) in enumerate(self.lists) if at == index)
        _, _, counted, width = self.lists[k]
        kind = self.element.properties[index].kind
        found: list[np.ndarray] = [np.empty((0, 3), np.int64)]
        for length in np.unique(self.lengths[k]):
            if length < 3:
                continue
            some = self.places[k][self.lengths[k] == length] + counted
            corners = self.take(some[:, None] + width * np.arange(length), kind).astype(np.int64)
            first = np.broadcast_to(corners[:, :1], corners[:, 2:].shape)
            found.append(
                np.stack([first, corners[:, 1:-1], corners[:, 2:]], axis=-1).reshape(-1, 3)
            )
        return np.concatenate(found)


def _declared(values: Num[np.ndarray, " n"], kind: np.dtype) -> Num[np.ndarray, " n"]:
    """Numbers of an ASCII file in the type that its header declares, unless they do not fit into it."""
    if values.dtype == kind:
        return values
    with np.errstate(all="ignore"):
        cast = values.astype(kind)
    return cast if kind.kind == "f" or (cast == values).all() else values


def _plural(name: str) -> str:
    return {"vertex": "vertices"}.get(name, f"{name}s")
