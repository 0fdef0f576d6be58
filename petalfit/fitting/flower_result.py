"""The result of the fit of a flower: its record, with methods that make a flower and a report of it."""

from __future__ import annotations

import os
from typing import ClassVar

import jax
import numpy as np

from petalfit.colours import Colour
from petalfit.components import ConeReceptacle
from petalfit.export.mesh import export_petals
from petalfit.fitting.result import FitResult
from petalfit.flowers import Arrangement, Flower, Series
from petalfit.report.flower_page import write_flower_report
from petalfit.results import FlowerRecord
from petalfit.surfaces import AbstractSurface

_SMALLEST = 0.05  # radius of the receptacle, in typical units of the petals
_UP = np.array([0.0, 1.0, 0.0])


class FlowerResult(FlowerRecord):
    """The petals of a flower that were recovered from one scan. See `FlowerRecord` for its attributes.

    Attributes:
        petals: The fits of the petals, as results with reports and draws.
        petal_kind: The class of these.
    """

    petals: tuple[FitResult, ...]
    petal_kind: ClassVar[type[FitResult]] = FitResult

    def report(self, path: str | os.PathLike[str]) -> None:
        """Write one self-contained HTML page with a picture, and a table of the petals."""
        write_flower_report(self, path)

    def export(self, path: str | os.PathLike[str]) -> None:
        """Write the petals in the target's frame as binary glTF, each as a named node.

        The file is written completely or not at all.

        Args:
            path: The path of the file, with the suffix .glb; an existing file is replaced.

        Raises:
            ValueError: The path has another suffix.
            OSError: The file cannot be written.
        """
        export_petals(dict(zip(self.names, self.petals, strict=True)), path)

    def flower(self, name: str = "scanned") -> Flower:
        """The petals as a flower that can be edited, grown again and exported.

        Its frame is the flower's own: it grows along +y, and `axis` maps it to the target's. The
        receptacle is only a small mark, because none was fitted.

        Args:
            name: The name of the flower.
        """
        receptacle = ConeReceptacle(r=_SMALLEST, h=2 * _SMALLEST)
        top = np.asarray(receptacle(0.5 * np.pi, 0.0))
        places = [self._attachment(petal, top) for petal in self.petals]
        azimuth = np.array([place.pop("azimuth") for place in places])
        rank = np.linspace(0.0, 1.0, self.count)
        rows = {field: np.array([place[field] for place in places]) for field in places[0]}
        models: list[AbstractSurface] = [petal.model for petal in self.petals]
        series = Series.of(
            "petal", models, Arrangement(azimuth, rank), Colour.of("#ecaabe"), **rows
        )
        green = Colour.of("#7f9a4a")
        return Flower(name, receptacle, None, (series,), {"receptacle": green, "pedicel": green})

    def _attachment(self, petal: FitResult, top: np.ndarray) -> dict[str, float]:
        """The fields of the attachment that puts a petal where it was fitted."""
        axis, pose = self.axis, petal.pose
        turned = np.asarray(axis.rotation).T @ np.asarray(pose.rotation)
        x, y, z = turned[:, 1]
        azimuth, opening = np.arctan2(z, x), np.arccos(np.clip(y, -1, 1))
        outwards = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
        around = np.array([-np.sin(azimuth), 0.0, np.cos(azimuth)])
        inwards = np.sin(opening) * _UP - np.cos(opening) * outwards
        roll = np.arctan2(turned[:, 2] @ around, turned[:, 2] @ inwards)
        base = axis.into(base_of(petal)[None])[0]
        return {
            "azimuth": float(azimuth),
            "radius": float(base @ outwards),
            "aside": float(base @ around),
            "height": float(base[1] - top[1]),
            "opening": float(opening),
            "roll": float(roll),
            "scale": float(pose.scale) / float(axis.scale),
        }


def base_of(petal: FitResult) -> np.ndarray:
    """The place of the middle of a petal's base in the target's frame."""
    with jax.enable_x64(True):
        base = np.asarray(petal.model(*petal.model.domain.base), np.float64)
        return np.asarray(petal.pose(base[None]))[0]
