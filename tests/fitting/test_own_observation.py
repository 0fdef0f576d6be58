"""A kind of observation and a loss that are defined outside of petalfit are used like its own."""

import dataclasses
from typing import Any, ClassVar

import numpy as np
import pytest
from jaxtyping import Float

import petalfit as pf
from petalfit.fitting.likelihood.mixture import Mixture
from petalfit.fitting.likelihood.observed import AbstractObserved, Residuals, ScoreAndInformation
from petalfit.fitting.likelihood.scales import spread_of
from petalfit.fitting.outliers.linear import Linear
from petalfit.fitting.outliers.loss import AbstractBackground
from petalfit.fitting.outliers.registry import LOSSES
from petalfit.fitting.silhouettes.observing import MAKERS
from petalfit.observations import AbstractObservation, observation_from_json
from petalfit.report.shown.protocol import AbstractShown
from petalfit.report.shown.registry import SHOWN
from petalfit.residuals import AbstractFrozen, AbstractTerm, places, pulled

PETAL = pf.PeonyPetal(a_x=13.0, b_y=24.0, c=0.5, dx=0.3, dy=2.0)
SIGMA = 0.02


@dataclasses.dataclass(frozen=True, eq=False)
class Landmarks(AbstractObservation):
    """Places of a petal that somebody recognised: where they are in (u, v), and in space."""

    kind: ClassVar[str] = "landmarks"
    unit: ClassVar[str] = "length"
    uv: np.ndarray
    points: np.ndarray

    @property
    def size(self) -> float:
        return float(np.linalg.norm(self.extent))

    @property
    def extent(self) -> np.ndarray:
        return np.ptp(self.points, axis=0)

    @property
    def described(self) -> str:
        return f"{len(self.points)} landmarks"

    def arrays(self) -> tuple[dict[str, Any], list]:
        return {}, [self.uv, self.points]

    def to_json(self) -> dict[str, Any]:
        return {"kind": self.kind, "uv": self.uv, "points": self.points}

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "Landmarks":
        return cls(np.array(content["uv"]), np.array(content["points"]))


@dataclasses.dataclass(frozen=True, eq=False)
class LandmarkDistance(AbstractTerm, AbstractFrozen):
    """All three coordinates of the distances, in units of σ."""

    uv: Float[np.ndarray, "n 2"]
    points: Float[np.ndarray, "n 3"]
    sigma: float

    def freeze(self, surface, free):
        return self, self, None

    def residual(self, position):
        return ((position - self.points) / self.sigma).ravel()

    def slopes(self, position):
        covectors = np.tile(np.eye(3) / self.sigma, (len(self.uv), 1))
        return np.repeat(np.arange(len(self.uv)), 3), covectors


@dataclasses.dataclass(frozen=True)
class ObservedLandmarks(AbstractObserved):
    """The likelihood of landmarks, whose places need no search."""

    marks: Landmarks

    def match(self, model, term):
        return LandmarkDistance(self.marks.uv, self.marks.points, SIGMA)

    def information(self, coordinates, t, term):
        model = coordinates.model(t)
        position = places(model, term.uv)
        index, covectors = term.slopes(position)
        slopes = pulled(model, term.uv[index], covectors, coordinates.free, position[index])
        slopes = slopes * coordinates.slopes(t)
        return slopes.T @ slopes, SIGMA

    def misfit(self, model):
        term = self.match(model, None)
        return float(np.log1p(np.mean(term.residual(places(model, term.uv)) ** 2)))

    def score_and_information(self, coordinates, t, term):
        information, _ = self.information(coordinates, t, term)
        return ScoreAndInformation(term, information, np.zeros(len(t)), information)

    def residuals(self, coordinates, t, term):
        position = places(coordinates.model(t), term.uv)
        gaps = term.residual(position).reshape(-1, 3) * SIGMA
        distance = np.linalg.norm(gaps, axis=1)
        chi2 = float(np.sum((distance / SIGMA) ** 2))
        return [Residuals(distance, np.ones(len(distance)), SIGMA, "length", chi2)]


class ShownLandmarks(AbstractShown):
    in_scene: ClassVar[bool] = False

    def sentence(self, part):
        return "Landmarks lie where they should."

    def facts(self, part):
        return {"landmarks": part.target.described}

    def distances(self, result, part, scene):
        return "<p>no drawing of landmarks</p>"


class Cauchy(Linear):
    """Heavy-tailed noise instead of outliers."""

    name: ClassVar[str] = "cauchy"
    meaning: ClassVar[str] = "noise with heavy tails"

    def background(self, points):
        return HeavyTails()


class HeavyTails(AbstractBackground):
    def mixture(self, model, distance, beyond, weights, noise):
        distance = np.hypot(distance, np.maximum(beyond, 0.0))
        sigma = noise or max(spread_of(distance), 1e-12)
        members = 1 / (1 + (distance / (3 * sigma)) ** 2)
        log_likelihood = -float(np.sum(weights * np.log1p((distance / sigma) ** 2)))
        return Mixture(members, float(np.mean(members)), sigma, log_likelihood)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(SHOWN, "landmarks", ShownLandmarks())
    monkeypatch.setitem(LOSSES, "cauchy", Cauchy())


def landmarks() -> Landmarks:
    uv = np.random.default_rng(0).uniform([-0.5, 0.0], [0.5, 1.0], (40, 2))
    return Landmarks(uv, np.asarray(PETAL(*uv.T), float))


def test_a_kind_of_observation_takes_part_in_a_joint_fit(monkeypatch, tmp_path):
    cloud = PETAL.sample(300, seed=3, noise=0.2)
    alone = pf.fit_petal(cloud)
    monkeypatch.setitem(
        MAKERS, Landmarks, lambda marks, request, rng: [ObservedLandmarks(x) for x in marks]
    )
    together = pf.fit_petal([landmarks(), cloud], throw=False)
    assert [part.target.kind for part in together.agreements] == ["landmarks", "cloud"]
    for name in ("a_x", "b_y", "dy"):
        assert together.stderr[name] < 0.3 * alone.stderr[name]
        assert abs(together.values[name] - getattr(PETAL, name)) < 5 * together.stderr[name]
    together.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json")
    assert again.input_hash == together.input_hash
    together.report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "40 landmarks" in page
    assert "no drawing of landmarks" in page


def test_a_kind_without_a_likelihood_is_refused():
    with pytest.raises(pf.TargetError, match="its likelihood is not known"):
        pf.fit_petal([PETAL.sample(300, seed=3), landmarks()])
    with pytest.raises(pf.TargetError, match="no kind of observation 'smell'"):
        observation_from_json({"kind": "smell"})


@pytest.mark.parametrize("model", [pf.PeonyPetal, pf.Ellipsoid], ids=lambda kind: kind.__name__)
def test_a_loss_serves_every_family(model):
    truth = PETAL if model is pf.PeonyPetal else pf.Ellipsoid(r_x=2.0, r_y=5.0, r_z=3.0)
    points = truth.sample(600, seed=2, noise=SIGMA).points.copy()
    points[::20] += np.random.default_rng(1).normal(scale=0.5, size=points[::20].shape)
    plain = pf.fit(model, points, throw=False)
    calm = pf.fit(model, points, loss="cauchy", throw=False)
    names = [name for name in calm.names if calm.identifiable[name]]

    def off(result: pf.FitResult) -> float:
        return sum(abs(result.values[n] - getattr(truth, n)) / calm.stderr[n] for n in names)

    assert off(calm) < 0.5 * off(plain)
    assert calm.weights[::20].mean() < 0.5 < calm.weights.mean()


def test_a_loss_serves_joint_fits():
    clouds = [PETAL.sample(400, seed=k, noise=SIGMA).points.copy() for k in (1, 2)]
    for points in clouds:
        points[::20] += np.random.default_rng(1).normal(scale=0.5, size=points[::20].shape)
    result = pf.fit_petal(clouds, loss="cauchy", throw=False)
    assert abs(result.values["a_x"] - PETAL.a_x) < 4 * result.stderr["a_x"]
    assert all(part.weights[::20].mean() < 0.5 for part in result.agreements)
    with pytest.raises(pf.TargetError, match="'linear' or 'robust' or 'cauchy'"):
        pf.fit_petal(clouds, loss="square")
