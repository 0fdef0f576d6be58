"""The items of a batch: all files of a folder, or all rows of a manifest."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from petalfit.components import model_named
from petalfit.observations import (
    IMAGE_SUFFIXES,
    SUFFIXES,
    AbstractObservation,
    Camera,
    TargetError,
    read_cameras,
    read_target,
)
from petalfit.version import VERSION

# The optional columns of a manifest, whose cells may be empty.
COLUMNS = ("id", "camera", "model", "pose", "loss", "noise", "free", "seed")
# The separator between several files in one cell, which are fitted together.
BETWEEN = ";"


class Item(NamedTuple):
    """A target of a batch.

    Attributes:
        id: A relative path: the name of the target in the table, and of its folder in the output.
        targets: The paths of the files that are fitted together.
        cameras: The paths of the camera files of the masks, in the order of the masks; may be empty.
        options: The options of the fit, as text and numbers: model, pose, loss, noise, free, seed.
    """

    id: str
    targets: tuple[Path, ...]
    cameras: tuple[Path, ...]
    options: Mapping[str, Any]

    def digest(self) -> str:
        """A digest of the content of the files, the options, and the version of petalfit.

        Raises:
            TargetError: A file cannot be read.
        """
        described = json.dumps([VERSION, dict(sorted(self.options.items()))])
        whole = hashlib.sha256(described.encode())
        for path in (*self.targets, *self.cameras):
            try:
                with open(path, "rb") as file:
                    whole.update(hashlib.file_digest(file, "sha256").digest())
            except OSError as error:
                raise TargetError(f"{path} cannot be read: {error.strerror or error}.") from None
        return whole.hexdigest()

    def read(self) -> list[AbstractObservation]:
        """Reads the observations from the files."""
        masks = [path for path in self.targets if path.suffix.lower() in IMAGE_SUFFIXES]
        cameras = dict(zip(masks, map(_camera, self.cameras), strict=False))
        return [read_target(path, cameras.get(path)) for path in self.targets]

    def arguments(self) -> dict[str, Any]:
        """The options as keyword arguments of `fit`."""
        name = self.options["model"]
        return {**self.options, "model": "auto" if name == "auto" else model_named(name)}


def _camera(path: Path) -> Camera:
    camera = read_cameras(path)
    if not isinstance(camera, Camera):
        raise TargetError(f"{path} has several cameras; a batch takes a file for each.")
    return camera


def items_of(source: Path, options: Mapping[str, Any]) -> list[Item]:
    """The targets of a folder and its subfolders, or of a manifest.

    Args:
        source: A folder, or a CSV file with a column "target" and any of `COLUMNS`; paths in it are
            relative to the folder of the CSV file.
        options: The options of every fit, which a manifest may override for its rows.

    Raises:
        TargetError: There is nothing to fit, or the manifest is invalid.
    """
    if source.is_dir():
        known = (*SUFFIXES, *IMAGE_SUFFIXES)
        files = sorted(
            path
            for path in source.rglob("*")
            if path.suffix.lower() in known
            and not any(part.startswith(".") for part in path.relative_to(source).parts)
        )
        if not files:
            raise TargetError(f"{source} has no file with a suffix of {' '.join(known)}.")
        return [Item(path.relative_to(source).as_posix(), (path,), (), options) for path in files]
    if source.suffix.lower() != ".csv":
        raise TargetError(
            f"{source} is neither a folder nor a .csv manifest with a column 'target'."
        )
    return _items_of_manifest(source, options)


def _items_of_manifest(manifest: Path, options: Mapping[str, Any]) -> list[Item]:
    try:
        with open(manifest, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            rows, columns = [*reader], reader.fieldnames or []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TargetError(f"{manifest} cannot be read as a manifest: {error}") from None
    unknown = [str(name) for name in columns if name not in ("target", *COLUMNS)]
    if "target" not in columns or unknown:
        wrong = "no column 'target'"
        if "target" in columns:
            wrong = f"unknown columns: {', '.join(unknown)}"
        raise TargetError(f"{manifest} has {wrong}; it may have target, {', '.join(COLUMNS)}.")
    if not rows:
        raise TargetError(f"{manifest} has a header and no rows; give a row for each target.")
    items, lines = [], {}
    for line, row in enumerate(rows, 2):
        cells = {name: text.strip() for name, text in row.items() if name and text and text.strip()}
        try:
            item = _item(cells, manifest.parent, options)
        except (TargetError, ValueError) as error:
            raise TargetError(f"{manifest}, line {line}: {error}") from None
        if item.id in lines:
            raise TargetError(
                f"{manifest}, lines {lines[item.id]} and {line} have the same id {item.id!r}; give "
                "every row an id of its own."
            )
        lines[item.id] = line
        items.append(item)
    return items


def _item(cells: Mapping[str, str], folder: Path, options: Mapping[str, Any]) -> Item:
    """The item of a row of a manifest, from its cells that are not empty."""
    for column, text in cells.items():
        if not text.isprintable():
            raise TargetError(f"the column {column!r} has characters that cannot be printed.")
    if "target" not in cells:
        raise TargetError("there is no target in this row.")
    targets = _paths(cells["target"], folder)
    name = cells.get("id", cells["target"]).replace("\\", "/").replace(BETWEEN, "+")
    # Two spellings of one folder are one id, and none leaves the output.
    parts = [part for part in PurePosixPath(name).parts if part not in ("/", "//", "..")]
    name = PurePosixPath(*parts).as_posix()
    if name in ("", "."):
        raise TargetError(f"the id {cells.get('id', '')!r} names no folder; give another one.")
    own: dict[str, Any] = {n: cells[n] for n in ("model", "pose", "loss") if n in cells}
    if "noise" in cells:
        own["noise"] = _noise(cells["noise"])
    if "seed" in cells:
        own["seed"] = _seed(cells["seed"])
    if "free" in cells:
        own["free"] = cells["free"].replace(",", " ").replace(BETWEEN, " ").split()
    merged = {**options, **own}
    if merged["model"] != "auto":
        model_named(merged["model"])
    return Item(name, targets, _paths(cells.get("camera", ""), folder), merged)


def _noise(text: str) -> float:
    noise = float(text)
    if not 0 < noise < math.inf:
        raise TargetError(f"the noise {text} is no standard deviation; give a positive number.")
    return noise


def _seed(text: str) -> int:
    seed = int(text)
    if not 0 <= seed < 2**63:
        raise TargetError(f"the seed {text[:20]} is out of range; give 0 or more, below 2^63.")
    return seed


def _paths(text: str, folder: Path) -> tuple[Path, ...]:
    return tuple(folder / part.strip() for part in text.split(BETWEEN) if part.strip())
