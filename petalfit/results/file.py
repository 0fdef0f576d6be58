"""What a fit.json holds: the declared types of its members, and what they must be together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence, Sized
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float64

from petalfit.components import Posed, parameters
from petalfit.observations import Contour, Silhouette, observation_from_json
from petalfit.results.agreement import Agreement
from petalfit.results.discrepancy import Discrepancy
from petalfit.results.estimate import Start
from petalfit.results.profile import Profile
from petalfit.results.status import Status
from petalfit.results.trait import TRAITS
from petalfit.results.warning import WarningKind
from petalfit.schema import Count, Finite, NotNegative, Positive, SchemaError, unpacked
from petalfit.surfaces import AbstractSurface, Pose, with_value

FORMAT = "petalfit.FitResult"
VERSION = 6
READ = (5, VERSION)  # files of version 5 have no packed arrays
LARGEST = 2_000_000_000  # bytes
_ROUNDING = 1e-6  # a result at a bound may lie beyond it by rounding
_LONGEST = 1e15  # of a petal in any unit
_GREATEST = 1e100  # of a length in a file: volumes of more are no numbers


@dataclasses.dataclass(frozen=True)
class Rank:
    """The rank of one family of petals among those that were fitted to the same cloud.

    Attributes:
        model: Name of the family's class of models.
        delta_bic: Difference of its information criterion (BIC) from the least one; 0 for the best. Ten
            is a strong preference.
        rms: Root mean square distance that it reached, in the target's unit.
        freedom: Effective number of parameters.
    """

    model: str
    delta_bic: float
    rms: float
    freedom: float


class Head(msgspec.Struct):
    """What says whether and how the rest can be read."""

    format: str = ""
    version: Any = None
    model: str = ""
    command: str = ""


class PoseOfFile(msgspec.Struct):
    """A pose."""

    rotation: tuple[Row, Row, Row]
    translation: Row
    scale: Positive


class WarningOfFile(msgspec.Struct):
    """A warning."""

    kind: WarningKind
    parameters: tuple[str, ...]
    text: str


class PosteriorOfFile(msgspec.Struct):
    """A posterior, its covariance by rows."""

    names: tuple[str, ...]
    covariance: list[list[Finite]]


class AgreementOfFile(msgspec.Struct):
    """The agreement of a target, which is an observation of any kind, with the surface."""

    target: dict[str, Any]
    distances: list[float] | bytes
    weights: list[NotNegative] | bytes
    noise: float
    uv: list[tuple[float, float]] | bytes | None


class FitFile(msgspec.Struct, kw_only=True):
    """A fit; see `petalfit.results.FitRecord` for its members."""

    options: dict[str, Any]
    values: dict[str, float]
    stderr: dict[str, float]
    identifiable: dict[str, bool]
    names: tuple[str, ...]
    covariance: list[list[float]]
    status: Status
    reason: str
    notes: tuple[str, ...]
    warnings: tuple[WarningOfFile, ...]
    steps: Count
    starts: tuple[Start, ...]
    timings: dict[str, NotNegative]
    pose: PoseOfFile
    agreements: tuple[AgreementOfFile, ...]
    freedom: float
    ranking: tuple[Rank, ...]
    pose_stderr: dict[str, float]
    profiles: dict[str, Profile]
    stderr_noise: dict[str, float] = {}
    discrepancy: Discrepancy | None = None
    posterior: PosteriorOfFile | None = None
    trait_errors: dict[str, NotNegative] = {}
    points_used: dict[str, Count] = {}
    in_image: bool = False
    made_by: str = ""
    command: str = ""


Row = tuple[Finite, Finite, Finite]


def pose_of(pose: PoseOfFile) -> Pose:
    """The pose that a file holds.

    Raises:
        SchemaError: It is no rotation with a scale and a shift of a size that scans have.
    """
    rotation = np.array(pose.rotation)
    turns = bool((np.abs(rotation) < 2).all())
    if not (turns and np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROUNDING)):
        raise SchemaError("the pose is no rotation")
    sizes = np.abs([pose.scale, *pose.translation])
    if not (sizes.max() < _GREATEST and sizes[0] > 1 / _GREATEST):
        raise SchemaError("the pose is larger or smaller than any scan")
    return Pose(rotation, np.array(pose.translation), pose.scale)


def matrix(rows: Sequence[Sequence[float]]) -> Float64[np.ndarray, "p p"]:
    """A square matrix from its rows.

    Raises:
        SchemaError: It is not square.
    """
    if any(len(row) != len(rows) for row in rows):
        raise SchemaError("a covariance is not square")
    return np.array(rows, float).reshape(len(rows), len(rows))


def model_of(file: FitFile, kind: type[AbstractSurface]) -> AbstractSurface:
    """The fitted model in its own frame.

    Raises:
        SchemaError: The options or the values are not those of the model's class.
    """
    usual = kind()
    options: dict[str, Any] = {}
    for name, given in file.options.items():
        known: Any = getattr(usual, name, None)
        if name not in {field.name for field in dataclasses.fields(kind)}:
            raise SchemaError(f"{name} is no option of {kind.__name__}")
        if np.ndim(known):
            try:
                given = np.array(given, float)
            except (TypeError, ValueError, OverflowError):
                raise SchemaError(f"{name} is no array of numbers") from None
            if given.shape != np.shape(known) or not np.isfinite(given).all():
                raise SchemaError(f"{name} is no array of {np.shape(known)} finite numbers")
        elif type(given) is not type(known):
            raise SchemaError(f"{name} is {given!r}, where a {type(known).__name__} is expected")
        options[name] = given
    model = kind(**options)
    declared = parameters(model)
    image = set(Posed.in_image) if file.in_image else set()
    # Files of versions that fitted upright masks only have no turn.
    named = set(file.values) | (image & {"turn_z"})
    if named != set(declared) | image:
        raise SchemaError(f"values do not name the parameters of {kind.__name__}")
    for name, parameter in declared.items():
        value = file.values[name]
        low, high = parameter.bounds
        rounding = _ROUNDING * (high - low)
        if parameter.unit == "length" and file.pose_stderr:
            # In a fitted pose lengths are in the unit of the target, which may be any.
            low, high, rounding = (-_LONGEST if low < 0 else 0.0), _LONGEST, 0.0
        inside = low - rounding <= value <= high + rounding
        if not inside and file.status is not Status.NOT_FINITE:
            raise SchemaError(f"{name} is {value:g}, outside of its range ({low:g}, {high:g})")
        model = with_value(model, name, value)
    return model


def agreement_of(part: AgreementOfFile) -> Agreement:
    """The agreement that a file describes.

    Raises:
        TargetError: The target cannot be used.
        SchemaError: The target does not have a datum for each distance.
    """
    target = observation_from_json(part.target)
    data = Contour.of(target).place if isinstance(target, Silhouette) else target
    distances, weights = unpacked(part.distances, -1), unpacked(part.weights, -1)
    uv = None if part.uv is None else unpacked(part.uv, -1, 2)
    if isinstance(data, Sized) and len(data) != len(distances):
        raise SchemaError(f"the {target.kind} does not have a datum for each distance")
    return Agreement(target, distances, weights, part.noise, uv)


def check(file: FitFile, model: AbstractSurface, agreements: Sequence[Agreement]) -> None:
    """Checks what the members of a file must be together.

    Args:
        file: The file.
        model: The model that it holds.
        agreements: The agreements that it holds.

    Raises:
        SchemaError: One of them contradicts another.
    """
    for holds, complaint in _laws(file, model, agreements):
        if not holds:
            raise SchemaError(complaint)


def _laws(
    file: FitFile, model: AbstractSurface, agreements: Sequence[Agreement]
) -> Iterator[tuple[bool, str]]:
    """Pairs of whether a law holds, and a complaint if it does not."""
    names, values = set(file.names), file.values
    yield len(names) == len(file.names), "a name stands twice among the names"
    yield names <= set(values), "there are names without a value"
    yield set(file.stderr) == names, "stderr does not have the names of the free parameters"
    yield (
        set(file.identifiable) == names,
        "identifiable does not have the names of the free parameters",
    )
    yield set(file.stderr_noise) in (set(), names), "stderr_noise does not have their names"
    if file.discrepancy is not None:
        yield set(file.stderr_noise) == names, "there is a discrepancy without stderr_noise"
    yield len(file.covariance) == len(names), "the covariance does not have a row for each name"
    errors = np.sqrt(np.abs(np.diag(matrix(file.covariance))))
    given = np.array([file.stderr[name] for name in file.names])
    yield (
        np.allclose(errors, given, rtol=_ROUNDING, atol=0, equal_nan=True),
        ("stderr are not the roots of the covariance's diagonal"),
    )
    if file.posterior is not None:
        own = file.posterior.names
        yield (
            len(set(own)) == len(own) == len(file.posterior.covariance),
            ("the posterior does not have a row for each name"),
        )
        yield (
            set(own) <= set(parameters(model)) | set(Posed.similarity),
            ("the posterior names unknown parameters"),
        )
    yield set(file.trait_errors) <= TRAITS, "trait_errors names unknown traits"
    yield set(file.pose_stderr) <= set(Posed.similarity), "pose_stderr names no parts of a pose"
    for start in file.starts:
        yield names <= set(start.values), "a start lacks a value"
    for name, profile in file.profiles.items():
        yield (
            name in values and len(profile.values) == len(profile.delta_chi2) > 1,
            (f"the profile of {name} has no value for each Δχ²"),
        )
    yield bool(agreements), "there is no target"
    for part in agreements:
        count = len(part.distances)
        yield len(part.weights) == count > 0, "there is not one weight for each distance"
        yield part.uv is None or len(part.uv) == count, "there is not one uv for each distance"
        allowed = np.isfinite(part.weights) & (part.weights >= 0)
        yield bool(allowed.all()), "a weight is negative or not finite"
        yield bool(part.weights.any()), "all weights are zero"
    if file.status is not Status.NOT_FINITE:
        distances = [part.distances for part in agreements]
        numbers = np.concatenate([[*values.values()], *distances])
        yield bool(np.isfinite(numbers).all()), "a value or a distance is not finite"
