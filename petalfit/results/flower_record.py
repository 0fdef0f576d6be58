"""The record of a flower that was recovered from one scan: everything that a flower.json holds."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float64, Int

from petalfit import schema
from petalfit.components import models
from petalfit.observations import PointCloud, TargetError, observation_from_json
from petalfit.observations.atomic import atomic_path
from petalfit.results.file import LARGEST, FitFile, Head, PoseOfFile, WarningOfFile, pose_of
from petalfit.results.layout import Layout, Quantity
from petalfit.results.record import FitRecord
from petalfit.results.spread import Spread, spreads_of
from petalfit.results.warning import FitWarning
from petalfit.schema import Count, NotNegative, SchemaError, encode, unpacked
from petalfit.surfaces import Pose
from petalfit.version import VERSION as PETALFIT

if TYPE_CHECKING:
    import trimesh

FORMAT = "petalfit.FlowerResult"
VERSION = 2
_READ = (1, VERSION)  # files of version 1 have no packed arrays
Record = TypeVar("Record", bound="FlowerRecord")


class FlowerFile(msgspec.Struct, kw_only=True):
    """A flower; see `FlowerRecord` for its members."""

    target: dict[str, Any]
    petals: list[msgspec.Raw]
    labels: list[int] | bytes
    memberships: list[list[NotNegative]] | bytes
    axis: PoseOfFile
    layout: Layout
    rivals: tuple[Count, ...]
    warnings: tuple[WarningOfFile, ...]
    shared: dict[str, Quantity] = {}
    made_by: str = ""
    command: str = ""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FlowerRecord:
    """The petals of a flower that were recovered from one scan, as a file holds them.

    Attributes:
        target: The cloud.
        petals: The fit of each petal to some of its points; the outermost whorl comes first, and in a
            whorl the petals go round by their angle.
        labels: The petal of every point of the cloud, −1 for none, shape (n,).
        memberships: The probability that each point belongs to each petal, shape (n, k). What is missing
            to 1 is the probability that it belongs to none.
        axis: The pose of the flower's frame in the target's. Its y axis is the flower's axis, its origin
            the place where the petals meet, and its unit the typical one of the petals' models.
        layout: How the petals are arranged about the axis.
        rivals: Other numbers of petals that the evidence hardly excludes.
        shared: The parameters that all petals have in common: the means of what each petal determined for
            itself. The fits of the petals hold them.
        warnings: Reasons to doubt the result.
        made_by: The version of petalfit that made the result.
        command: The command line that made the result; empty if none did.
        petal_kind: The class of the petals' fits.
    """

    target: PointCloud
    petals: tuple[FitRecord, ...]
    labels: Int[np.ndarray, " n"]
    memberships: Float64[np.ndarray, "n k"]
    axis: Pose
    layout: Layout
    rivals: tuple[int, ...] = ()
    shared: Mapping[str, Quantity] = dataclasses.field(default_factory=dict)
    warnings: tuple[FitWarning, ...] = ()
    made_by: str = f"petalfit {PETALFIT}"
    command: str = ""
    petal_kind: ClassVar[type[FitRecord]] = FitRecord

    @property
    def count(self) -> int:
        """The number of petals."""
        return len(self.petals)

    @property
    def names(self) -> list[str]:
        """The names of the petals: petal_1 and so on."""
        return [f"petal_{k + 1}" for k in range(self.count)]

    @property
    def converged(self) -> bool:
        """Whether the fits of all petals converged."""
        return all(petal.converged for petal in self.petals)

    @property
    def spread(self) -> dict[str, Spread]:
        """How alike the petals are: mean and standard deviation of every trait and parameter.

        Traits come first, in the target's unit; then the parameters that have other names. What fewer
        than three petals determine is left out.
        """
        return spreads_of(self.petals)

    def mesh(self, resolution: tuple[int, int] = (65, 65)) -> trimesh.Scene:
        """The fitted petals as a scene in the target's frame, with one named mesh a petal."""
        import trimesh

        scene = trimesh.Scene()
        for name, petal in zip(self.names, self.petals, strict=True):
            scene.add_geometry(petal.mesh(resolution), node_name=name, geom_name=name)
        return scene

    def table(self) -> str:
        """The petals as CSV: their points, their whorl, and what is measured, with errors."""
        whorl = {k: n + 1 for n, ring in enumerate(self.layout.whorls) for k in ring.petals}
        traits = list(self.petals[0].traits) if self.petals else []
        heads = [head for name in traits for head in (name, f"{name}_stderr")]
        rows = [["petal", "whorl", "points", "rms", "status", *heads]]
        for k, (name, petal) in enumerate(zip(self.names, self.petals, strict=True)):
            numbers = [
                (petal.traits[trait].value, petal.traits[trait].stderr) for trait in petal.traits
            ]
            points = str(np.count_nonzero(self.labels == k))
            head = [name, str(whorl.get(k, "")), points, repr(petal.rms), str(petal.status)]
            rows.append([*head, *(repr(x) for pair in numbers for x in pair)])
        return "".join(",".join(row) + "\n" for row in rows)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything as lossless JSON, which `load` reads. A failure leaves no partial file."""
        own = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("target", "petals", "warnings")
        }
        content = encode({"format": FORMAT, "version": VERSION} | own) | {
            "target": encode(self.target.to_json()),
            "petals": [petal.to_json() for petal in self.petals],
            "warnings": [warning.to_json() for warning in self.warnings],
        }
        with atomic_path(path) as temporary:
            schema.write(temporary, content)

    @classmethod
    def load(cls: type[Record], path: str | os.PathLike[str]) -> Record:
        """Read what `save` wrote.

        Raises:
            TargetError: The file cannot be read, is damaged, or holds no flower of a known version.
        """
        name = os.fspath(path)
        try:
            head = schema.read(path, Head, LARGEST)
        except (OSError, SchemaError) as error:
            raise TargetError(f"{name} cannot be read as a flower's fit: {error}.") from None
        if head.format != FORMAT or head.version not in _READ:
            raise TargetError(
                f"{name} is not a flower's fit of version {VERSION}; `petalfit flower` writes them."
            )
        try:
            return cls._of(schema.read(path, FlowerFile, LARGEST))
        except (OSError, ValueError) as error:
            reason = str(error).removesuffix(".")
            raise TargetError(f"{name} is a damaged flower's fit: {reason}; fit again.") from error

    @classmethod
    def _of(cls: type[Record], file: FlowerFile) -> Record:
        petals = tuple(cls._petal(bytes(content)) for content in file.petals)
        target = observation_from_json(file.target)
        if not isinstance(target, PointCloud):
            raise SchemaError("the target is no cloud")
        labels = unpacked(file.labels, -1)
        whole = np.isin(labels, np.arange(-1, len(petals))).all()
        if len(labels) != len(target) or not whole:
            raise SchemaError("the labels do not name a petal for each point")
        memberships = unpacked(file.memberships, len(target), len(petals))
        if not (np.isfinite(memberships) & (memberships >= 0)).all():
            raise SchemaError("a membership is negative or not finite")
        numbers = {k for whorl in file.layout.whorls for k in whorl.petals}
        if not numbers <= set(range(len(petals))):
            raise SchemaError("a whorl names a petal that is not there")
        return cls(
            target=target,
            petals=petals,
            labels=labels.astype(int),
            memberships=memberships,
            axis=pose_of(file.axis),
            layout=file.layout,
            rivals=file.rivals,
            shared=file.shared,
            warnings=tuple(FitWarning(w.text, w.kind, w.parameters) for w in file.warnings),
            made_by=file.made_by,
            command=file.command,
        )

    @classmethod
    def _petal(cls, content: bytes) -> FitRecord:
        head = schema.parsed(content, Head)
        if head.model not in models():
            raise SchemaError(f"{head.model!r} is no component that petalfit knows")
        return cls.petal_kind.of_file(schema.parsed(content, FitFile), models()[head.model])
