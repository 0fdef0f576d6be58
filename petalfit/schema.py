"""JSON files that are checked against declared types while they are parsed.

What a file may hold is declared as a `msgspec.Struct`: types, ranges and lengths. msgspec builds nothing
that the declaration does not name, so that neither deep nesting nor numbers beyond float64 get further.
Infinities and NaN, which JSON does not have, are the strings "inf", "-inf" and "nan" (`encode`); a
`Finite` number is none of them. Arrays of very many numbers are strings too, because these take far less
space and time: their doubles, little-endian, in base64 (`unpacked`).
"""

from __future__ import annotations

import base64
import dataclasses
import os
import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float64

Content = TypeVar("Content")

_MOST = sys.float_info.max
Finite = Annotated[float, msgspec.Meta(ge=-_MOST, le=_MOST)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=_MOST)]
Positive = Annotated[float, msgspec.Meta(gt=0, le=_MOST)]
# Whole numbers that fit 64 bits with room to add to them.
Count = Annotated[int, msgspec.Meta(ge=0, lt=2**53)]

_LONGEST = 200  # characters of a value, or of its place, in an error
_MANY = 300_000  # numbers; larger arrays are packed

_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "null": "null",
    "array": "a list",
    "object": "an object",
}


class SchemaError(ValueError):
    """Content that is not what its declaration says; the message is the part of a sentence."""


def read(path: str | os.PathLike[str], kind: type[Content], most: int) -> Content:
    """Reads a JSON file as a declared type.

    Args:
        path: The path of the file.
        kind: The type.
        most: The largest size of the file, in bytes; a larger one is not read.

    Raises:
        SchemaError: The file is too large, no JSON, or does not hold what the type says.
        OSError: The file cannot be read.
    """
    with open(path, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise SchemaError(f"it is larger than {most / 1e6:.0f} MB")
    return parsed(content, kind)


def parsed(content: bytes, kind: type[Content]) -> Content:
    """JSON as a declared type.

    Raises:
        SchemaError: It is no JSON, or does not hold what the type says.
    """
    try:
        return msgspec.json.decode(content, type=kind, strict=False)
    except msgspec.ValidationError as error:
        raise SchemaError(_said(str(error))) from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise SchemaError(
            f"it is no JSON: {str(error).removeprefix('JSON is malformed: ')}"
        ) from None
    except RecursionError:
        raise SchemaError("it is nested too deeply") from None


def encode(value: Any) -> Any:
    """A value as JSON holds it: arrays as lists, dataclasses as objects, infinities as strings."""
    if isinstance(value, dict):
        return {key: encode(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.size > _MANY:
        return base64.b64encode(np.ascontiguousarray(value, "<f8").data).decode("ascii")
    if isinstance(value, np.ndarray):
        return value.tolist() if np.isfinite(value).all() else encode(value.tolist())
    if isinstance(value, list | tuple):
        return [encode(item) for item in value]
    if dataclasses.is_dataclass(value):
        return {
            field.name: encode(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if isinstance(value, float) and not np.isfinite(value):
        return str(float(value))
    return value


def unpacked(numbers: Sequence | bytes, *shape: int) -> Float64[np.ndarray, "..."]:
    """The array that `encode` wrote, as a list or packed.

    Args:
        numbers: The list, or the doubles.
        shape: The shape of the array; one side may be −1.

    Raises:
        SchemaError: The numbers do not have this shape.
    """
    try:
        flat = np.frombuffer(numbers, "<f8") if isinstance(numbers, bytes) else numbers
        array = np.array(flat, np.float64)
        shaped = array.reshape(shape)
    except ValueError:
        raise SchemaError("an array has the wrong number of numbers") from None
    if array.size and not isinstance(numbers, bytes) and array.shape != shaped.shape:
        raise SchemaError("an array has the wrong number of columns")
    return shaped


def write(path: str | os.PathLike[str], content: Any) -> None:
    """Writes what `encode` returned as JSON, with a member in each line."""
    with open(path, "wb") as file:
        file.write(
            msgspec.json.format(msgspec.json.encode(content, enc_hook=np.generic.item), indent=1)
        )
        file.write(b"\n")


def _said(text: str) -> str:
    """An error of msgspec's in our words: "Expected `int`, got `str` - at `$.steps`"."""
    what, _, place = text.partition(" - at ")
    where = place.strip("`").removeprefix("$").lstrip(".").replace("[...]", "")
    what = re.sub(r"`float` [<>]= -?1\.79\S+", "a finite number", what)
    what = re.sub(r"`(\w+)`", lambda word: _WORDS.get(word[1], word[1]), what)
    # A value that is not one of a few is repeated in whole, however long it is.
    what, where = shortened(what[0].lower() + what[1:]), shortened(where)
    return f"in {where}, {what}" if where else what


def shortened(text: str, most: int = _LONGEST) -> str:
    """A text, or the beginning of a long one."""
    return text if len(text) <= most else f"{text[:most]}…"
