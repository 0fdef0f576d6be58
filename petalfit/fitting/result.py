"""What a fit returns: values, how sure they are, and what the data cannot tell."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float64

from petalfit import components
from petalfit.components import Parameter, Posed, parameters
from petalfit.fitting.estimate import Estimate, Start, quantile
from petalfit.fitting.misfit import MisfitMap
from petalfit.fitting.targets import digest_of, target_from_json, target_to_json
from petalfit.observations import PointCloud, Silhouette, TargetError
from petalfit.observations.atomic import atomic_path
from petalfit.surfaces import AbstractSurface, Domain, Pose, moved, with_value
from petalfit.version import VERSION

if TYPE_CHECKING:
    import trimesh

FORMAT = "petalfit.FitResult"
VERSION = 3


@dataclasses.dataclass(frozen=True)
class Profile:
    """A profile likelihood: what the best fit costs with one parameter held.

    Attributes:
        values: Of the parameter, ascending.
        delta_chi2: How much worse χ² is there than at the best of them.
    """

    values: tuple[float, ...]
    delta_chi2: tuple[float, ...]

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Where Δχ² stays below the quantile of χ² with one degree of freedom; ±inf where it never rises.

        Args:
            level: Probability that the interval covers the truth, in (0, 1).
        """
        limit = quantile(level) ** 2
        cost, best = np.array(self.delta_chi2), int(np.argmin(self.delta_chi2))
        ends = []
        for side, never in ((slice(best, None, -1), -np.inf), (slice(best, None), np.inf)):
            values, costs = np.array(self.values)[side], cost[side]
            above = np.flatnonzero(costs > limit)
            if not len(above):
                ends.append(never)
                continue
            k = int(above[0])
            # Δχ² is nearly a parabola: its root is nearly straight.
            low, high = np.sqrt(costs[k - 1]), np.sqrt(costs[k])
            share = (np.sqrt(limit) - low) / (high - low)
            ends.append(float(values[k - 1] + share * (values[k] - values[k - 1])))
        return ends[0], ends[1]


@dataclasses.dataclass(frozen=True, eq=False)
class Agreement:
    """One target beside the fitted surface.

    Attributes:
        target: What was fitted.
        distances: Of a cloud, the signed normal distance of every point (+ on the side of the normal),
            or its distance to the edge where it lies beyond, in the target's unit. Of a silhouette,
            the signed distance of every place of its contour to the model's outline (+ outside of
            it), in pixels. Shape (n,).
        weights: The weight every datum had in the fit, shape (n,).
        noise: Standard deviation of the distances, given or estimated, in their unit.
        uv: Foot points of a cloud on a single surface, shape (n, 2); else None.
    """

    target: PointCloud | Silhouette
    distances: Float64[np.ndarray, " n"]
    weights: Float64[np.ndarray, " n"]
    noise: float
    uv: Float64[np.ndarray, "n 2"] | None = None

    @property
    def used(self) -> Bool[np.ndarray, " n"]:
        """Which data have a weight, and are not taken for strays: they kept at least half of it."""
        positive = self.weights > 0
        if isinstance(self.target, Silhouette):
            return positive
        given = self.target.weights
        return positive & (self.weights >= 0.5 * (1.0 if given is None else given))

    @property
    def strays(self) -> int:
        """How many points have a weight, but more likely belong to something else."""
        if isinstance(self.target, Silhouette):
            return 0
        given = self.target.weights
        count = len(self.target) if given is None else np.count_nonzero(given)
        return int(count - np.count_nonzero(self.used))

    @property
    def rms(self) -> float:
        """Root mean square distance, in the unit of the distances."""
        squares = np.average(self.distances**2, weights=self.weights)
        return float(np.sqrt(squares)) if np.isfinite(squares) else float("inf")

    def misfit(self, domain: Domain) -> MisfitMap | None:
        """Where points lie off a surface of that domain together; None if foot points are not known."""
        if self.uv is None:
            return None
        weights = np.where(self.used, self.weights, 0.0)
        return MisfitMap.of(domain, self.uv, self.distances, weights)

    @property
    def unit(self) -> str:
        """Of the distances: "length", the target's, or "px"."""
        return "px" if isinstance(self.target, Silhouette) else "length"


@dataclasses.dataclass(frozen=True)
class Rank:
    """A family of petals among others that were fitted to the same cloud.

    Attributes:
        model: Name of the family.
        delta_bic: How much greater its information criterion is than the best one's; 0 for the best.
            Ten is a strong preference.
        rms: Root mean square distance that it reached, in the target's unit.
        freedom: How many numbers it could choose.
    """

    model: str
    delta_bic: float
    rms: float
    freedom: float


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FitResult(Estimate):
    """The outcome of a fit of a component to clouds and silhouettes.

    Attributes:
        model: The fitted component, in its own frame.
        pose: From the model's frame to the target's.
        agreements: Every target beside the fitted surface, in the order in which they were given.
        freedom: How many numbers the fit could choose: free parameters, those of a pose among them, or
            what the coefficients of a smoothed sheet amount to.
        ranking: Of model="auto", the families that were tried, the best first; else empty.
        profiles: Profile likelihoods by parameter, as far as they were asked for (`with_profile`).
        pose_stderr: Standard errors of a fitted pose: turn_x, turn_y and turn_z about the model's axes
            in rad, shift_x, shift_y and shift_z in the target's unit, and scale. Empty if it was known.
        made_by: The version of petalfit that made it.
        command: The command line that made it; empty if none did.
    """

    model: AbstractSurface
    pose: Pose
    agreements: tuple[Agreement, ...]
    freedom: float
    ranking: tuple[Rank, ...] = ()
    pose_stderr: dict[str, float] = dataclasses.field(default_factory=dict)
    profiles: dict[str, Profile] = dataclasses.field(default_factory=dict)
    made_by: str = f"petalfit {VERSION}"
    command: str = ""

    @property
    def input_hash(self) -> str:
        """SHA-256 of the numbers of the targets: the same for the same data, whatever their file."""
        return digest_of([part.target for part in self.agreements])

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
        """Where the first target's points lie off the surface together; None for a silhouette."""
        return self.agreements[0].misfit(self.model.domain)

    @property
    def distances(self) -> Float64[np.ndarray, " n"]:
        """Signed distances of all data, one target after the other; see `Agreement`."""
        return np.concatenate([part.distances for part in self.agreements])

    @property
    def weights(self) -> Float64[np.ndarray, " n"]:
        """The weight every datum had in the fit, one target after the other."""
        return np.concatenate([part.weights for part in self.agreements])

    @property
    def declared(self) -> dict[str, Parameter]:
        """Of all that has a value: the model's parameters, and a fitted place in an image."""
        found = super().declared
        if "scale" in self.values:
            rows, columns = self.agreements[0].target.mask.shape  # pyright: ignore[reportAttributeAccessIssue]
            scale = self.values["scale"]
            typical = {
                "scale": (0.3 * scale, 3 * scale),
                "shift_x": (0.0, float(columns)),
                "shift_y": (0.0, float(rows)),
            }
            own = parameters(Posed)
            for name in Posed.in_image:
                found[name] = dataclasses.replace(own[name], unit="px", typical=typical[name])
        return found

    def with_profile(
        self, name: str, points: int = 11, progress: Callable[[str], None] | None = None
    ) -> FitResult:
        """The result with the profile likelihood of a parameter, which takes a fit for every point.

        It tells what the covariance cannot: limits that are not symmetric, and a second minimum.

        Args:
            name: A free parameter.
            points: How many values are held, over 5 standard errors to either side, or over the typical
                range of what is not determined.
            progress: Called with a line of text for every point.

        Raises:
            TargetError: The parameter was not fitted.
        """
        from petalfit.fitting.profile import with_profile

        return with_profile(self, name, points, progress)

    def ranked(self, ranking: tuple[Rank, ...]) -> FitResult:
        """The result as the best of several families, which its message then says."""
        _, *others = ranking
        words = [f"{other.model} is worse by {other.delta_bic:.0f} in BIC" for other in others]
        message = "; ".join([self.message, *words])
        return dataclasses.replace(self, ranking=ranking, message=message)

    def mesh(self, resolution: tuple[int, int] = (65, 65)) -> trimesh.Trimesh:
        """The fitted surface as a triangle mesh with UVs, in the target's frame."""
        return moved(self.model.mesh(resolution), self.pose)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything as JSON, lossless; `load` gives it back. Whole or not at all."""
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(self._to_json(), indent=1, allow_nan=False) + "\n")

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], model: type[AbstractSurface] | None = None
    ) -> FitResult:
        """Read what `save` wrote.

        Args:
            path: Of the file.
            model: The component that was fitted, if it is none of petalfit's own.

        Raises:
            TargetError: The file cannot be read, is damaged, or is no fit result of a known version, or
                of a component that is not known.
        """
        try:
            with open(path, encoding="utf-8") as file:
                content = json.load(file)
        except (OSError, ValueError) as error:
            raise TargetError(
                f"{os.fspath(path)} cannot be read as a fit result: {error}"
            ) from None
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise TargetError(f"{os.fspath(path)} is not a fit result; `petalfit fit` writes them.")
        if content.get("version") != VERSION:
            raise TargetError(
                f"{os.fspath(path)} has version {content.get('version')} of the format; this "
                f"petalfit reads version {VERSION}."
            )
        name = content.get("model")
        kind = model or getattr(components, str(name), None)
        if kind is None or kind.__name__ != name:
            raise TargetError(
                f"{os.fspath(path)} is a fit of a {name}, which petalfit does not know: give its class "
                "as model."
            )
        try:
            return cls._from_json(content, kind)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise TargetError(
                f"{os.fspath(path)} is a damaged fit result ({error!r}); fit again."
            ) from error

    def report(self, path: str | os.PathLike[str]) -> None:
        """Write one self-contained HTML page with the parameter table and pictures."""
        from petalfit.report import write_report

        write_report(self, path)

    def _to_json(self) -> dict[str, Any]:
        fields: dict[str, Any] = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("model", "agreements")
        }
        fields["pose"] = dataclasses.asdict(self.pose)
        fields["starts"] = [dataclasses.asdict(start) for start in self.starts]
        fields["ranking"] = [dataclasses.asdict(rank) for rank in self.ranking]
        fields["profiles"] = {name: dataclasses.asdict(p) for name, p in self.profiles.items()}
        fields["agreements"] = [
            {
                "target": target_to_json(part.target),
                "distances": part.distances,
                "weights": part.weights,
                "noise": part.noise,
                "uv": part.uv,
            }
            for part in self.agreements
        ]
        head: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "model": type(self.model).__name__,
        }
        head["options"] = {
            field.name: _encode(getattr(self.model, field.name))
            for field in dataclasses.fields(self.model)
            if field.metadata.get("static") or np.ndim(getattr(self.model, field.name)) > 0
        }
        return head | {name: _encode(value) for name, value in fields.items()}

    @classmethod
    def _from_json(cls, content: dict[str, Any], kind: type[AbstractSurface]) -> FitResult:
        fields = {name: _decode(value) for name, value in content.items()}
        options = {
            name: np.array(x, float) if isinstance(x, list) else x
            for name, x in fields["options"].items()
        }
        model = kind(**options)
        for name in parameters(model):
            model = with_value(model, name, float(fields["values"][name]))
        pose = fields["pose"]
        kept = {field.name for field in dataclasses.fields(cls)} & fields.keys()
        return cls(
            **{name: fields[name] for name in kept}
            | {
                "model": model,
                "pose": Pose(
                    np.array(pose["rotation"]), np.array(pose["translation"]), pose["scale"]
                ),
                "names": tuple(fields["names"]),
                "made_by": fields.get("made_by", "an earlier petalfit"),
                "covariance": np.array(fields["covariance"], float).reshape(
                    2 * (len(fields["names"]),)
                ),
                "warnings": tuple(fields["warnings"]),
                "starts": tuple(Start(**start) for start in fields["starts"]),
                "ranking": tuple(Rank(**rank) for rank in fields["ranking"]),
                "profiles": {
                    name: Profile(tuple(p["values"]), tuple(p["delta_chi2"]))
                    for name, p in fields["profiles"].items()
                },
                "agreements": tuple(
                    Agreement(
                        target_from_json(part["target"]),
                        np.array(part["distances"], float),
                        np.array(part["weights"], float),
                        part["noise"],
                        None if part.get("uv") is None else np.array(part["uv"], float),
                    )
                    for part in fields["agreements"]
                ),
            }
        )


_NOT_FINITE = {"inf": np.inf, "-inf": -np.inf, "nan": np.nan}


def _encode(value: Any) -> Any:
    """JSON has no infinities: they become strings."""
    if isinstance(value, dict):
        return {key: _encode(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist() if np.isfinite(value).all() else _encode(value.tolist())
    if isinstance(value, list | tuple):
        return [_encode(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return str(float(value))
    return value


def _decode(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _decode(item) for key, item in value.items()}
    if isinstance(value, list):
        flat = value and isinstance(value[0], float)
        return value if flat and all(type(x) is float for x in value) else [*map(_decode, value)]
    return _NOT_FINITE.get(value, value) if isinstance(value, str) else value
