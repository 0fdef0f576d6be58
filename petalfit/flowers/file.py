"""Flowers as JSON, written by a person or by `petalfit grow -o flower.json`."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from petalfit import colours, components, schema
from petalfit.colours import AbstractPattern, Colour, from_hex, to_hex
from petalfit.components import AbstractAssembly, Pedicel, models, parameters
from petalfit.flowers import phyllotaxis
from petalfit.flowers.androecium import stamens
from petalfit.flowers.attachment import Attachment
from petalfit.flowers.flower import Flower, Series
from petalfit.flowers.grown import PETAL, require_memory
from petalfit.flowers.gynoecium import pistils
from petalfit.flowers.phyllotaxis import Arrangement
from petalfit.flowers.settings import FlowerError, checked, declared
from petalfit.observations.atomic import atomic_path
from petalfit.schema import SchemaError
from petalfit.surfaces import AbstractSurface, value_at, with_value

FORMAT, VERSION = "petalfit.Flower", 1
_LARGEST = 100_000_000  # bytes
_ARRANGEMENTS = ("whorls", "recursion", "scattered", "l_system", "azimuth")


def save_flower(flower: Flower, path: str | os.PathLike[str]) -> None:
    """Write a flower as lossless JSON, which `load_flower` reads; completely or not at all.

    Args:
        flower: The flower.
        path: The path of the file; an existing file is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(flower_to_json(flower), indent=1) + "\n", encoding="utf-8")


def load_flower(path: str | os.PathLike[str], seed: int = 0) -> Flower:
    """Read a flower from a JSON file, whose format docs/flowers.md describes.

    Args:
        path: The path of the file.
        seed: The seed of what the file leaves to chance: scattered places and jitter.

    Raises:
        FlowerError: The file cannot be read, or does not describe a flower that can be grown.
    """
    try:
        content = schema.read(path, dict, _LARGEST)
    except (OSError, SchemaError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise FlowerError(f"{os.fspath(path)} cannot be read as a flower: {reason}.") from None
    try:
        return flower_from_json(content, seed)
    except FlowerError as error:
        raise FlowerError(f"{os.fspath(path)}: {error}") from None
    except OverflowError:
        raise FlowerError(f"{os.fspath(path)}: a number in it is too large.") from None


def flower_from_json(content: Any, seed: int = 0) -> Flower:
    """A flower from the content of its JSON file; see `load_flower`.

    Raises:
        FlowerError: The content does not describe a flower that can be grown.
    """
    entry = _Entry(content, "the flower", seed)
    if entry.take("format", FORMAT) != FORMAT or entry.take("version", VERSION) != VERSION:
        raise FlowerError(f"this is no flower; its format is {FORMAT!r}, version {VERSION}.")
    name = entry.text("name", "flower")
    rng = np.random.default_rng(seed)
    receptacle, green = _single(entry.take("receptacle", {"component": "Bowl"}), "receptacle")
    if isinstance(receptacle, AbstractAssembly):
        raise FlowerError("receptacle: its component is a single surface, a Bowl for instance.")
    pedicel, stalk = None, green
    if (described := entry.take("pedicel", None)) is not None:
        pedicel, stalk = _single(
            {"component": "Pedicel", **_mapping(described, "pedicel")}, "pedicel"
        )
        if not isinstance(pedicel, Pedicel):
            raise FlowerError("pedicel: its component is a Pedicel.")
    series = entry.take("series", [])
    if not isinstance(series, list):
        raise FlowerError("series is a list of organs.")
    grown = tuple(_series(part, k, seed, rng) for k, part in enumerate(series))
    entry.finish()
    try:
        return Flower(name, receptacle, pedicel, grown, {"receptacle": green, "pedicel": stalk})
    except ValueError as error:
        raise FlowerError(f"{error}.") from None


class _Entry:
    """A JSON object of the file; its members are taken one by one, and unknown ones are an error."""

    def __init__(self, content: Any, where: str, seed: int = 0) -> None:
        self.members = dict(_mapping(content, where))
        self.where = where
        self.known: list[str] = []

    def take(self, name: str, default: Any = None) -> Any:
        self.known.append(name)
        return self.members.pop(name, default)

    def text(self, name: str, default: str) -> str:
        value = self.take(name, default)
        if not isinstance(value, str) or not value or "/" in value:
            raise FlowerError(f"{self.where}: {name} is {value!r}; give it a name.")
        return value

    def whole(self, name: str, default: int, least: int) -> int:
        value = self.take(name, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise FlowerError(
                f"{self.where}: {name} is {value!r}, where a whole number of {least} or more is wanted."
            )
        return value

    def finish(self) -> None:
        if self.members:
            raise FlowerError(
                f"{self.where}: {', '.join(map(repr, self.members))} means nothing here; what is known "
                f"is {', '.join(self.known)}."
            )


def _mapping(content: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        raise FlowerError(f"{where}: an object with members in braces is wanted.")
    return content


def _organ(entry: _Entry) -> AbstractSurface:
    """A component with default parameters and the options that the file gives it."""
    kinds, name = models(), entry.take("component")
    if not isinstance(name, str) or name not in kinds:
        raise FlowerError(
            f"{entry.where}: there is no component {name!r}; there are {', '.join(kinds)}."
        )
    kind = kinds[name]
    options = _mapping(entry.take("options", {}), f"{entry.where}: options")
    static = {f.name for f in dataclasses.fields(kind) if f.metadata.get("static")}
    if unknown := set(options) - static:
        raise FlowerError(
            f"{entry.where}: {', '.join(sorted(unknown))} is no option of {kind.__name__}, which has "
            f"{', '.join(static) or 'none'}."
        )
    try:
        return kind(**options)
    except (TypeError, ValueError) as error:
        raise FlowerError(f"{entry.where}: {error}.") from None


def _single(content: Any, where: str) -> tuple[AbstractSurface, Colour]:
    """The receptacle or the pedicel, and its colour."""
    entry = _Entry(content, where)
    organ = _with_parameters(_organ(entry), entry)
    colour = _colour(entry.take("colour", "#7f9a4a"), where)
    entry.finish()
    return organ, colour


def _with_parameters(organ: Any, entry: _Entry) -> Any:
    """An organ with the parameters that the file gives it."""
    given = _mapping(entry.take("parameters", {}), f"{entry.where}: parameters")
    for path, value in given.items():
        parameter = declared(organ, path, entry.where)
        organ = with_value(organ, path, checked(value, path, parameter, entry.where))
    return organ


def _require_room(organs: int) -> None:
    """Raises an error for too large a count, before arrays of that length are made."""
    require_memory(float(np.prod(PETAL)) * organs)


def _series(content: Any, number: int, seed: int, rng: np.random.Generator) -> Series:
    entry = _Entry(content, f"series {number + 1}")
    kinds = [name for name in ("stamens", "pistils") if name in entry.members]
    if kinds:
        series = _of_a_kind(entry, kinds[0])
    else:
        name = entry.text("name", "")
        entry.where = name
        organ = _organ(entry)
        arrangement = _arrangement(entry, seed)
        series = Series.of(name, organ, arrangement, Colour.of("#dddddd"))
        rank = arrangement.rank
        series = _with_values(series, entry, "attachment", rank, rng)
        series = _with_values(series, entry, "organ", rank, rng)
    series = _painted(series, entry)
    entry.finish()
    return series


def _of_a_kind(entry: _Entry, what: str) -> Series:
    """Stamens or pistils of a named kind; the parameters in the file apply to each of them."""
    kind = entry.take(what)
    entry.where = f"{kind} {what}"
    organ: Any = components.Stamen() if what == "stamens" else components.Pistil()
    organ = _with_parameters(organ, entry)
    try:
        if what == "stamens":
            count = entry.whole("count", 0, 0) or None
            _require_room(count or 1)
            return stamens(kind, count, organ)
        carpels = entry.whole("carpels", 1, 1)
        _require_room(carpels)
        return pistils(kind, carpels, organ)
    except ValueError as error:
        raise FlowerError(f"{entry.where}: {error}.") from None


def _arrangement(entry: _Entry, seed: int) -> Arrangement:
    found = [name for name in _ARRANGEMENTS if name in entry.members]
    if len(found) > 1:
        raise FlowerError(f"{entry.where}: give one of {' and '.join(found)}, not both.")
    how = found[0] if found else "whorls"
    given = {name: entry.take(name) for name in _ARRANGEMENTS}[how]
    try:
        match how:
            case "whorls":
                counts = [1] if given is None else given if isinstance(given, list) else [given]
                _require_whole(counts)
                _require_room(sum(counts))
                return phyllotaxis.whorls(*counts)
            case "azimuth":
                angles = np.array(given, float)
                if angles.ndim != 1 or not len(angles) or not np.isfinite(angles).all():
                    raise FlowerError("azimuth is a list of angles in rad")
                return Arrangement(angles, np.linspace(0, 1, len(angles)))
            case "l_system":
                return phyllotaxis.l_system(**given)
            case _:
                options = dict(given) if isinstance(given, dict) else {"count": given}
                _require_whole([options.get("count")])
                _require_room(options["count"])
                if how == "scattered":
                    options.setdefault("seed", seed)
                return getattr(phyllotaxis, how)(**options)
    except (TypeError, ValueError) as error:
        raise FlowerError(f"{entry.where}: {how}: {error}.") from None


def _require_whole(counts: list[Any]) -> None:
    for count in counts:
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise FlowerError(f"a count is a whole number of 1 or more; received {count!r}")


def _with_values(
    series: Series, entry: _Entry, field: str, rank: np.ndarray, rng: np.random.Generator
) -> Series:
    """The series with the values that the file gives to its attachment, or to its organs."""
    members = entry.take("attachment" if field == "attachment" else "parameters", {})
    part = getattr(series, field)
    one = jax.tree.map(lambda leaf: leaf[0], part)
    for path, given in _mapping(members, f"{entry.where}: {field}").items():
        parameter = declared(one, path, entry.where)
        row = _row(given, rank, rng, f"{entry.where}.{path}")
        row = np.array([checked(value, path, parameter, entry.where) for value in row])
        part = with_value(part, path, row)
    return eqx.tree_at(lambda s: getattr(s, field), series, part)


def _row(given: Any, rank: np.ndarray, rng: np.random.Generator, where: str) -> list[Any]:
    """One value per organ, from one number for all, a list, or a change from outside to inside."""
    if isinstance(given, list):
        if len(given) != len(rank):
            raise FlowerError(f"{where} has {len(given)} values for {len(rank)} organs.")
        return given
    if not isinstance(given, dict):
        return [given] * len(rank)
    numbers = {"outer", "inner", "jitter"}
    if not ({"outer", "inner"} <= set(given) <= numbers) or not all(
        isinstance(x, int | float) and not isinstance(x, bool) for x in given.values()
    ):
        raise FlowerError(
            f"{where} is a number, a list, or an object with the numbers outer and inner, and jitter if "
            "wanted (a standard deviation)."
        )
    values = given["outer"] + (given["inner"] - given["outer"]) * rank
    return [*(values + given.get("jitter", 0.0) * rng.standard_normal(len(rank)))]


def _painted(series: Series, entry: _Entry) -> Series:
    one, several = entry.take("colour"), entry.take("colours", {})
    paint = dict(series.colours)
    if one is not None:
        paint = dict.fromkeys(paint, _colour(one, entry.where))
    for part, colour in _mapping(several, f"{entry.where}: colours").items():
        if part not in paint:
            raise FlowerError(
                f"{entry.where}: there is no part {part!r} to colour; there are "
                f"{', '.join(map(repr, paint))}."
            )
        paint[part] = _colour(colour, f"{entry.where}: {part}")
    return dataclasses.replace(series, colours=paint)


def _colour(content: Any, where: str) -> Colour:
    """A colour from its text, or from a palette with patterns."""
    entry = _Entry({"palette": [content]} if isinstance(content, str) else content, where)
    palette, patterns = entry.take("palette", []), entry.take("patterns", [])
    entry.finish()
    if not isinstance(palette, list) or not isinstance(patterns, list):
        raise FlowerError(f"{where}: palette and patterns are lists.")
    try:
        rows = [from_hex(c) if isinstance(c, str) else np.array(c, float) for c in palette]
        stacked = np.stack(rows)
        if stacked.shape[1:] != (3,) or not ((stacked >= 0) & (stacked <= 1)).all():
            raise FlowerError("a colour is written like '#c2185b', or as three numbers from 0 to 1")
        return Colour(stacked, tuple(_pattern(pattern, where) for pattern in patterns))
    except FlowerError as error:
        raise FlowerError(f"{where}: {error}") from None
    except (TypeError, ValueError) as error:
        raise FlowerError(f"{where}: {error}.") from None


def _pattern(content: Any, where: str) -> AbstractPattern:
    members = dict(_mapping(content, where))
    name = members.pop("pattern", None)
    kinds = {kind.__name__: kind for kind in (colours.RadialPattern, colours.RibPattern)}
    if not isinstance(name, str) or name not in kinds:
        raise FlowerError(f"there is no pattern {name!r}; there are {', '.join(kinds)}.")
    known = parameters(kinds[name])
    values = {
        path: checked(value, path, declared(kinds[name](), path, name), name)
        for path, value in members.items()
    }
    return kinds[name](**{path: values[path] for path in known if path in values})


def flower_to_json(flower: Flower) -> dict[str, Any]:
    """A flower as lossless JSON."""
    green = flower.colours
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": flower.name,
        "receptacle": _described(flower.receptacle)
        | {"colour": _painted_json(green["receptacle"])},
        "pedicel": None
        if flower.pedicel is None
        else _described(flower.pedicel) | {"colour": _painted_json(green["pedicel"])},
        "series": [
            {
                "name": series.name,
                **_described(series.one(0), series.organ),
                "azimuth": np.asarray(series.attachment.azimuth).tolist(),
                "attachment": {
                    name: _numbers(getattr(series.attachment, name))
                    for name in parameters(Attachment)
                    if name != "azimuth"
                },
                "colours": {part: _painted_json(c) for part, c in sorted(series.colours.items())},
            }
            for series in flower.series
        ],
    }


def _described(one: eqx.Module, all_: eqx.Module | None = None) -> dict[str, Any]:
    """A component, its options and its parameters; if `all_` is given, those of a whole series."""
    options = {
        f.name: getattr(one, f.name) for f in dataclasses.fields(one) if f.metadata.get("static")
    }
    values = {path: _numbers(value_at(all_ or one, path)) for path in parameters(one)}
    return {"component": type(one).__name__, **({"options": options} if options else {}),
            "parameters": values}  # fmt: skip


def _numbers(values: Any) -> float | list[float]:
    """The list of all values, or one number if they are all equal."""
    row = np.asarray(values, np.float64)
    return float(row.flat[0]) if (row == row.flat[0]).all() else row.tolist()


def _painted_json(colour: Colour) -> str | dict[str, Any]:
    palette = [to_hex(c) if (from_hex(to_hex(c)) == c).all() else np.asarray(c, float).tolist()
               for c in np.asarray(colour.palette)]  # fmt: skip
    if colour.is_plain and isinstance(palette[0], str):
        return palette[0]
    patterns = [
        {"pattern": type(p).__name__} | {name: float(getattr(p, name)) for name in parameters(p)}
        for p in colour.patterns
    ]
    return {"palette": palette, "patterns": patterns}
