"""The record of a fit: everything that a fit.json holds."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
from jaxtyping import Float64

from petalfit import schema
from petalfit.components import Parameter, Posed, models, parameters
from petalfit.observations import TargetError
from petalfit.observations.atomic import atomic_path
from petalfit.results.agreement import Agreement
from petalfit.results.discrepancy import Discrepancy
from petalfit.results.estimate import Estimate, Start, rivals
from petalfit.results.file import (
    FORMAT,
    LARGEST,
    READ,
    VERSION,
    FitFile,
    Head,
    Rank,
    agreement_of,
    check,
    matrix,
    model_of,
    pose_of,
)
from petalfit.results.misfit import MisfitMap
from petalfit.results.profile import Profile
from petalfit.results.trait import Posterior, Trait, traits_of
from petalfit.results.warning import FitWarning
from petalfit.schema import SchemaError, encode, shortened
from petalfit.surfaces import AbstractSurface, Pose, moved
from petalfit.version import VERSION as PETALFIT

if TYPE_CHECKING:
    import trimesh

Record = TypeVar("Record", bound="FitRecord")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FitRecord(Estimate):
    """The outcome of a fit of a component to clouds and silhouettes, as a file holds it.

    Attributes:
        model: The fitted component, in its own frame.
        pose: The pose, which maps the model's frame to the target's.
        agreements: The agreement of every target with the surface, in the order in which they were given.
        freedom: Effective number of parameters: the number of free parameters, including those of a pose,
            or what the smoothed coefficients of a spline surface amount to.
        ranking: With model="auto", the families that were tried, the best first; else empty.
        profiles: Profile likelihoods by name of the parameter, for those that `with_profile` computed.
        pose_stderr: Standard errors of a fitted pose: turn_x, turn_y and turn_z about the model's axes
            in rad, shift_x, shift_y and shift_z in the target's unit, and scale. Empty if it was known.
        stderr_noise: Standard errors by name if all of the distances were independent noise. `stderr`
            allows for a discrepancy too.
        discrepancy: The smooth part of the distances, which the model cannot follow; None if noise alone
            explains them, or if it is not estimated (masks, joint fits).
        posterior: What is known of all free parameters together; None if they have no errors.
        trait_errors: Standard errors of the traits by name, if they follow from coefficients without a
            name, and not from `posterior`; else empty.
        points_used: The number of points that each stage of the fit to a large cloud used; empty if all
            stages used all points. Residuals, and what follows from them, are those of all points.
        in_image: Whether a mask without a camera was fitted. The values then include the place in the
            image: scale, in pixels a unit, shift_x and shift_y, in pixels, and turn_z, in rad
            counterclockwise, 0 if y is up.
        made_by: The version of petalfit that made the result.
        command: The command line that made the result; empty if none did.
    """

    model: AbstractSurface
    pose: Pose
    agreements: tuple[Agreement, ...]
    freedom: float
    ranking: tuple[Rank, ...] = ()
    pose_stderr: dict[str, float] = dataclasses.field(default_factory=dict)
    profiles: dict[str, Profile] = dataclasses.field(default_factory=dict)
    stderr_noise: dict[str, float] = dataclasses.field(default_factory=dict)
    discrepancy: Discrepancy | None = None
    posterior: Posterior | None = None
    trait_errors: dict[str, float] = dataclasses.field(default_factory=dict)
    points_used: dict[str, int] = dataclasses.field(default_factory=dict)
    in_image: bool = False
    made_by: str = f"petalfit {PETALFIT}"
    command: str = ""

    @property
    def rivals(self) -> tuple[Start, ...]:
        """Other starts that ended elsewhere, almost as well: the data hardly distinguish them."""
        inflation = 1.0 if self.discrepancy is None else self.discrepancy.inflation
        return rivals(self.starts, self.stderr, self.declared, inflation)

    @property
    def input_hash(self) -> str:
        """SHA-256 of the numbers in the targets: the same for the same data, whatever file has them."""
        whole = hashlib.sha256()
        for part in self.agreements:
            for block in part.target.content():
                whole.update(block)
        return whole.hexdigest()

    @property
    def noise(self) -> float:
        """Standard deviation σ of the first target's noise, given or estimated, in its unit."""
        return self.agreements[0].noise

    @property
    def rms(self) -> float:
        """Root mean square distance of the first target's data to the surface, in its unit."""
        return self.agreements[0].rms

    @property
    def misfit(self) -> MisfitMap | None:
        """The map of mean distances of the first target over the surface; None for a silhouette."""
        return self.agreements[0].misfit(self.model.domain)

    @property
    def distances(self) -> Float64[np.ndarray, " n"]:
        """Signed distances of all data, one target after the other; see `Agreement`."""
        return np.concatenate([part.distances for part in self.agreements])

    @property
    def weights(self) -> Float64[np.ndarray, " n"]:
        """The weights that all data had in the fit, one target after the other."""
        return np.concatenate([part.weights for part in self.agreements])

    @cached_property
    def traits(self) -> dict[str, Trait]:
        """What botanists measure, by name, in the target's unit; empty for anything but a sheet.

        See `petalfit.results.trait`. Errors allow for those of a fitted scale, and are infinite if the
        parameters have none.
        """
        if not np.isfinite(list(self.values.values())).all():
            return {}
        length = "px" if self.in_image else "unit"
        scale = float(self.pose.scale)
        return traits_of(self.model, scale, self.posterior, length, self.trait_errors)

    @property
    def declared(self) -> dict[str, Parameter]:
        """The declarations of the model's parameters, and of those of a fitted place in an image."""
        found = super().declared
        if self.in_image:
            width, height = map(float, self.agreements[0].target.extent)
            scale = self.values["scale"]
            typical = {
                "scale": (0.3 * scale, 3 * scale),
                "shift_x": (0.0, width),
                "shift_y": (0.0, height),
                "turn_z": (-np.pi, np.pi),
            }
            own = parameters(Posed)
            for name in Posed.in_image:
                unit = own[name].unit if name == "turn_z" else "px"
                found[name] = dataclasses.replace(own[name], unit=unit, typical=typical[name])
        return found

    def ranked(self: Record, ranking: tuple[Rank, ...]) -> Record:
        """The result as the best of several families, with the ranking and a note for each other one."""
        _, *others = ranking
        words = [f"{other.model} is worse by {other.delta_bic:.0f} in BIC" for other in others]
        return dataclasses.replace(self, ranking=ranking, notes=(*self.notes, *words))

    def mesh(self, resolution: tuple[int, int] = (65, 65)) -> trimesh.Trimesh:
        """The fitted surface as a triangle mesh with UVs, in the target's frame."""
        return moved(self.model.mesh(resolution), self.pose)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything as lossless JSON, which `load` reads. A failure leaves no partial file."""
        with atomic_path(path) as temporary:
            schema.write(temporary, self.to_json())

    @classmethod
    def load(
        cls: type[Record],
        path: str | os.PathLike[str],
        model: type[AbstractSurface] | None = None,
    ) -> Record:
        """Read what `save` wrote.

        Args:
            path: The path of the file.
            model: The class of the fitted component, if it is none of petalfit's own.

        Raises:
            TargetError: The file cannot be read, is damaged, or holds no fit result of a known version
                and a known component.
        """
        name = os.fspath(path)
        try:
            head = schema.read(path, Head, LARGEST)
        except (OSError, SchemaError) as error:
            raise TargetError(f"{name} cannot be read as a fit result: {error}.") from None
        if head.format != FORMAT:
            raise TargetError(f"{name} is not a fit result; `petalfit fit` writes them.")
        if head.version not in READ:
            raise TargetError(
                f"{name} has version {shortened(str(head.version))} of the format, and this petalfit "
                f"reads version {VERSION}. Fit the target again: "
                f"{shortened(head.command or 'petalfit fit TARGET --out DIR', 800)}"
            )
        kind = model or models().get(head.model)
        if kind is None or kind.__name__ != head.model:
            raise TargetError(
                f"{name} is a fit of a {head.model}, which petalfit does not know: give its class as "
                "model."
            )
        try:
            return cls.of_file(schema.read(path, FitFile, LARGEST), kind)
        except (OSError, ValueError) as error:
            reason = str(error).removesuffix(".")
            raise TargetError(f"{name} is a damaged fit result: {reason}; fit again.") from error

    _apart: ClassVar[tuple[str, ...]] = ("model", "agreements", "warnings")

    def to_json(self) -> dict[str, Any]:
        """Everything as lossless JSON, which `of_file` reads after it has been checked."""
        fields: dict[str, Any] = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in self._apart
        }
        fields["warnings"] = [warning.to_json() for warning in self.warnings]
        fields["agreements"] = [
            vars(part) | {"target": part.target.to_json()} for part in self.agreements
        ]
        head: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "model": type(self.model).__name__,
            # These follow from the other fields; they are there for people who read the file.
            "converged": self.converged,
            "message": self.message,
        }
        options = {
            field.name: getattr(self.model, field.name)
            for field in dataclasses.fields(self.model)
            if field.metadata.get("static") or np.ndim(getattr(self.model, field.name)) > 0
        }
        return encode(head | {"options": options} | fields)

    @classmethod
    def of_file(cls: type[Record], file: FitFile, kind: type[AbstractSurface]) -> Record:
        """The record that a file holds, with the class of its model."""
        model = model_of(file, kind)
        agreements = tuple(map(agreement_of, file.agreements))
        check(file, model, agreements)
        kept = {field.name for field in dataclasses.fields(cls)} & set(FitFile.__struct_fields__)
        fields: dict[str, Any] = {name: getattr(file, name) for name in kept}
        fields["pose"] = pose_of(file.pose)
        fields["covariance"] = matrix(file.covariance)
        fields["posterior"] = file.posterior and Posterior(
            file.posterior.names, matrix(file.posterior.covariance)
        )
        fields["warnings"] = tuple(
            FitWarning(warning.text, warning.kind, warning.parameters) for warning in file.warnings
        )
        fields["agreements"] = agreements
        return cls(model=model, **fields)
