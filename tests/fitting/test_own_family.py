"""A family of models that a user defines outside of petalfit takes part in everything."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import petalfit as pf
from petalfit.surfaces import length, number


class Saddle(pf.AbstractSurface):
    """A rectangle whose margins rise or fall by one parabola, and whose ends by another."""

    length: pf.Scalar = length(10.0, "L", (0.01, 1000.0), (3.0, 40.0), "from end to end")
    width: pf.Scalar = number(0.6, "w", (0.05, 0.95), (0.3, 0.9), "from side to side, in lengths")
    across: pf.Scalar = number(0.0, "a", (-2.0, 2.0), (-0.5, 0.5), "rise of the sides, in lengths")
    along: pf.Scalar = number(0.0, "b", (-2.0, 2.0), (-0.5, 0.5), "rise of the ends, in lengths")
    domain: ClassVar[pf.Domain] = pf.Domain((-0.5, 0.5), (-0.5, 0.5))
    regular: ClassVar[bool] = True

    def position(self, u, v):
        rise = 4 * (self.across * u**2 + self.along * v**2)
        return self.length * jnp.stack([self.width * u, v, rise], axis=-1)


class SaddleFamily(pf.OpenSurfaceFamily):
    """Saddles begin flat, along the principal axes of their cloud."""

    kind = Saddle
    gauges: ClassVar = {"similarity": ("length",)}
    is_petal = True

    def starts(self, template, free, points, pose):
        del free
        centre = points.mean(axis=0)
        _, axes = np.linalg.eigh((points - centre).T @ (points - centre))
        rotation = axes[:, [1, 2, 0]]
        rotation[:, 2] *= np.linalg.det(rotation)
        width, reach = np.ptp((points - centre) @ rotation, axis=0)[:2]
        flat = Saddle(length=template.length, width=width / reach)
        scale = reach / float(template.length)
        start = pf.CloudStart(flat, rotation, centre, scale, "flat")
        return [start.scaled("length", pose)]


TRUTH = Saddle(length=10.0, width=0.6, across=0.12, along=-0.2)
NOISE = 0.02


@pytest.fixture(scope="module", autouse=True)
def registered():
    pf.register(SaddleFamily())


@pytest.fixture(scope="module")
def scan() -> np.ndarray:
    """A cloud of the saddle in another unit, turned and shifted."""
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    points = TRUTH.sample(768, seed=1, noise=NOISE).points
    return 3.0 * points @ (turn * np.linalg.det(turn)).T + [5.0, -7.0, 2.0]


def agrees(result: pf.FitResult) -> bool:
    """Whether the shape is the truth's; turned over, both rises change their sign."""
    sign = np.sign(result.values["across"])
    true = {"width": 0.6, "across": sign * 0.12, "along": sign * -0.2}
    return all(abs(result.values[n] - x) < 5 * result.stderr[n] for n, x in true.items())


def test_it_is_found_in_any_pose_and_unit(scan):
    result = pf.fit(Saddle, scan, pose="similarity")
    assert result.status is pf.Status.CONVERGED
    assert agrees(result)
    assert result.values["length"] == 10.0
    assert "length" not in result.names
    assert result.pose.scale == pytest.approx(3.0, rel=0.01)
    assert result.noise == pytest.approx(3.0 * NOISE, rel=0.1)


def test_outliers_are_found_too(scan):
    rng = np.random.default_rng(2)
    outliers = rng.uniform(scan.min(axis=0), scan.max(axis=0), (192, 3))
    result = pf.fit(Saddle, np.concatenate([scan, outliers]), pose="similarity", loss="robust")
    assert agrees(result)
    inside = result.agreements[0].used
    assert inside[:768].mean() > 0.95
    assert inside[768:].mean() < 0.2


def test_it_takes_part_in_the_choice_of_a_family(scan):
    result = pf.fit_petal(scan, model="auto", pose="similarity", throw=False)
    ranks = {rank.model: rank.delta_bic for rank in result.ranking}
    assert set(ranks) >= {"Saddle", "BladePetal", "SplinePetal"}
    # A blade can have the same shape, with many more numbers; a peony petal cannot.
    assert ranks["Saddle"] == 0 < ranks["SplinePetal"]


def test_its_file_and_its_report_name_it(scan, tmp_path):
    result = pf.fit(Saddle, scan, pose="similarity")
    result.save(tmp_path / "fit.json")
    assert pf.FitResult.load(tmp_path / "fit.json", model=Saddle).values == result.values
    result.report(tmp_path / "report.html")
    assert "Saddle fitted to" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_what_is_no_family_is_refused():
    with pytest.raises(TypeError, match="family"):
        pf.register(SaddleFamily)

    class WithoutKind(pf.OpenSurfaceFamily):
        def starts(self, template, free, points, pose):
            return []

    with pytest.raises(TypeError, match="needs a kind"):
        pf.register(WithoutKind())
