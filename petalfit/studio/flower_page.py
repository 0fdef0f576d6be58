"""The page of a whole flower: sliders and colours of every organ, and export as glTF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import viser

from petalfit.colours import Colour
from petalfit.components import parameters
from petalfit.export.flower import export_flower
from petalfit.flowers import Flower, lily, peony, save_flower, with_settings
from petalfit.report.portrait import Sheet, flower_sheets
from petalfit.studio import words
from petalfit.studio.session import Session
from petalfit.studio.sliders import add_slider
from petalfit.surfaces import Parameter, grid_faces, value_at

_KINDS: dict[str, Callable[[int], Flower]] = {"lily": lily, "peony": peony}
_SCANNED = "the scanned one"
_SINGLE = 60  # the most organs of a series that are listed one by one
_FINE = 33  # number of vertices along u in the preview of a petal
_BASE = ("receptacle", "pedicel")


class FlowerPage:
    """The controls of the page, and the flower that they describe."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._flower: Flower | None = None
        self._scanned: Flower | None = None
        self._controls: list[Any] = []
        self._sliders: dict[str, Any] = {}
        gui, reacting = session.gui, session.reacting
        self.place = gui.add_folder(None)
        with self.place:
            gui.add_html(words.soft("A whole flower; every number and colour of every organ."))
            self._kind = gui.add_dropdown("Flower", [*_KINDS])
            self._seed = gui.add_number(
                "Seed", 0, min=0, step=1, hint="Another seed is another flower of the kind"
            )
            self._organ = gui.add_dropdown(
                "Organ", ["petal"], hint="All of a kind, which keep their differences, or one"
            )
            self._about = gui.add_html("")
            self._numbers = gui.add_folder("Parameters")
            self._colours = gui.add_folder("Colours")
            with gui.add_folder("Download"):
                glb = gui.add_button("flower.glb", icon=viser.Icon.DOWNLOAD, hint=_GLB)
                text = gui.add_button("flower.json", icon=viser.Icon.DOWNLOAD, hint=_JSON)
        self._kind.on_update(reacting(lambda _: self._grow()))
        self._seed.on_update(reacting(lambda _: self._grow()))
        self._organ.on_update(reacting(lambda _: self._add_controls()))
        glb.on_click(reacting(lambda _: self._download("flower.glb", export_flower)))
        text.on_click(reacting(lambda _: self._download("flower.json", save_flower)))

    def open(self) -> None:
        """Shows the current flower, or grows the first one."""
        self._session.scenery.clear()
        if self._flower is None:
            self._grow()
        else:
            self._draw(look=True)

    def leave(self) -> None:
        """Nothing goes on that another page would disturb."""

    def take(self, flower: Flower) -> None:
        """Makes a flower that was found in a scan the current one."""
        self._session.scenery.clear()
        self._scanned = flower
        self._kind.options = [*_KINDS, _SCANNED]
        if self._kind.value == _SCANNED:
            self._grow()
        self._kind.value = _SCANNED  # a change of it grows the flower

    def _grow(self) -> None:
        scanned = self._scanned if self._kind.value == _SCANNED else None
        self._seed.disabled = scanned is not None
        self._flower = flower = scanned or _KINDS[self._kind.value](int(self._seed.value))
        names = [series.name for series in flower.series]
        organs = [*names, "receptacle", *(["pedicel"] if flower.pedicel is not None else [])]
        for series in flower.series:
            if 1 < len(series) <= _SINGLE:
                organs += series.names
        kept = self._organ.value if self._organ.value in organs else names[0]
        self._organ.options = organs
        self._organ.value = kept
        self._about.content = words.soft(
            ", ".join(f"{len(s)} {s.name}{'s' * (len(s) > 1)}" for s in flower.series)
        )
        self._add_controls()
        self._draw(look=True)

    def _add_controls(self) -> None:
        """Adds the sliders and colours of the selected organ."""
        gui, flower = self._session.gui, self._flower
        assert flower is not None, "a flower has been grown"
        for control in self._controls:
            control.remove()
        self._controls = []
        organ = self._organ.value
        with self._numbers:
            for path, parameter, values in _numbers(flower, organ):

                def moved(path: str = path) -> None:
                    self._moved(organ, path)

                self._sliders[path] = add_slider(
                    gui, path, parameter, float(np.mean(values)), self._session.latest(moved)
                )
                self._controls.append(self._sliders[path])
        with self._colours:
            for part, k, rgb in _palette(flower, organ):
                label = " ".join([part or organ, *([f"pattern {k}"] if k else [])])
                picker = gui.add_rgb(label, rgb)

                def painted(part: str = part, k: int = k, picker: Any = picker) -> None:
                    self._paint(organ, part, k, picker.value)

                picker.on_update(self._session.latest(painted))
                self._controls.append(picker)

    def _moved(self, organ: str, path: str) -> None:
        """Changes a number of all selected organs by the same amount; their mean follows the slider."""
        flower = self._flower
        assert flower is not None, "a flower has been grown"
        parameter, values = next((p, x) for name, p, x in _numbers(flower, organ) if name == path)
        new = np.clip(values + self._sliders[path].value - np.mean(values), *parameter.bounds)
        settings = zip(_members(flower, organ), new, strict=True)
        self._flower = with_settings(flower, {f"{name}.{path}": float(x) for name, x in settings})
        self._draw()

    def _paint(self, organ: str, part: str, k: int, rgb: tuple[int, int, int]) -> None:
        flower = self._flower
        assert flower is not None, "a flower has been grown"

        def place(flower: Flower) -> Any:
            return _colours(flower, organ)[part].palette

        palette = np.array(place(flower), np.float64)
        palette[k] = np.array(rgb) / 255
        self._flower = eqx.tree_at(place, flower, palette)
        self._draw()

    def _draw(self, look: bool = False) -> None:
        assert self._flower is not None, "a flower has been grown"
        sheets = flower_sheets(self._flower)
        self._session.scenery.model("flower", _preview(sheets))
        if look:
            corners = [sheet.vertices.reshape(-1, 3) for sheet in sheets]
            self._session.scenery.look_at(np.concatenate(corners))

    def _download(self, name: str, write: Callable[[Flower, Path], None]) -> None:
        flower = self._flower
        assert flower is not None, "a flower has been grown"
        self._session.download(name, lambda path: write(flower, path))


_GLB = "As glTF: organs as named nodes, textures, the parameters in extras"
_JSON = "All numbers; change them, and grow it with `petalfit grow flower.json -o flower.glb`"


def _series_of(flower: Flower, organ: str) -> int:
    return next(
        k for k, series in enumerate(flower.series) if organ in (series.name, *series.names)
    )


def _members(flower: Flower, organ: str) -> list[str]:
    """The names of the organs that a choice stands for: all of a series, or one."""
    if organ in _BASE:
        return [organ]
    series = flower.series[_series_of(flower, organ)]
    return series.names if organ == series.name else [organ]


def _numbers(flower: Flower, organ: str) -> list[tuple[str, Parameter, np.ndarray]]:
    """Path, declaration and values (one per organ) of the numbers of the selected organs."""
    if organ in _BASE:
        one = getattr(flower, organ)
        return [
            (path, parameter, np.atleast_1d(np.asarray(value_at(one, path), np.float64)))
            for path, parameter in parameters(one).items()
        ]
    series = flower.series[_series_of(flower, organ)]
    which = slice(None) if organ == series.name else [series.names.index(organ)]
    found = []
    for whole, one in ((series.organ, series.one(0)), (series.attachment, series.attachment)):
        for path, parameter in parameters(one).items():
            if path == "azimuth" and organ == series.name and len(series) > 1:
                continue  # they stand all around the axis, so their mean means nothing
            values = np.asarray(value_at(whole, path), np.float64)[which]
            found.append((path, parameter, values))
    return found


def _colours(flower: Flower, organ: str) -> dict[str, Colour]:
    """The colours of an organ by the names of its parts."""
    if organ in _BASE:
        return {"": flower.colours[organ]}
    return flower.series[_series_of(flower, organ)].colours


def _palette(flower: Flower, organ: str) -> list[tuple[str, int, tuple[int, int, int]]]:
    """Part, number and RGB value of every colour in the palettes of an organ."""
    return [
        (part, k, tuple(np.rint(255 * np.asarray(rgb)).astype(int).tolist()))
        for part, colour in _colours(flower, organ).items()
        for k, rgb in enumerate(np.asarray(colour.palette))
    ]


def _preview(sheets: list[Sheet]) -> bytes:
    """All surfaces as one coarse glTF mesh with colours at its vertices."""
    import trimesh
    from trimesh.exchange.gltf import export_glb

    places, normals, colours, faces, count = [], [], [], [], 0
    for sheet in sheets:
        step = max(1, (sheet.vertices.shape[0] - 1) // (_FINE - 1))
        grid = [array[::step, ::step] for array in sheet]
        shape = grid[0].shape[:2]
        faces.append(grid_faces((shape[0], shape[1]), 1) + count)
        count += shape[0] * shape[1]
        for kept, array in zip((places, normals, colours), grid, strict=True):
            kept.append(array.reshape(-1, 3))
    linear = np.clip(np.concatenate(colours), 0, 1)
    opaque = np.column_stack([linear, np.ones(len(linear))])
    mesh = trimesh.Trimesh(
        np.concatenate(places),
        np.concatenate(faces),
        vertex_normals=np.concatenate(normals),
        vertex_colors=np.rint(255 * opaque).astype(np.uint8),
        process=False,
    )

    def matt(tree: dict[str, Any]) -> None:
        surface = {"metallicFactor": 0.0, "roughnessFactor": 0.75}
        tree["materials"] = [{"pbrMetallicRoughness": surface, "doubleSided": True}]
        for each in tree["meshes"]:
            for primitive in each["primitives"]:
                primitive["material"] = 0

    content = export_glb(trimesh.Scene(mesh), include_normals=True, tree_postprocessor=matt)
    assert isinstance(content, bytes)
    return content
