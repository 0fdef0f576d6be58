"""The descent of a sheet to its stationary point: derivatives, starts, bounds and prior."""

import jax
import numpy as np
import pytest
import trimesh

import petalfit as pf
from petalfit.fitting.likelihood.sheet import Sheet
from petalfit.fitting.solver import descent as solver
from petalfit.fitting.solver.descent import Descent, DescentEnd, begun, descend

FREE = ("length", "width", "widest", "tip_width", "tip_taper", "bend", "cup_mid", "twist")
TRUTH = {"length": 2.0, "width": 0.6, "bend": 0.9, "cup_mid": 0.6, "twist": 0.2}
NOISE = 0.01


def cloud(seed: int, count: int = 700) -> np.ndarray:
    """Points spread evenly over the blade, with noise."""
    rng = np.random.default_rng(seed)
    blade = pf.BladePetal(**TRUTH)
    points, _ = trimesh.sample.sample_surface(blade.mesh((161, 161)), count, seed=seed)
    return np.asarray(points) + rng.normal(0, NOISE, (count, 3))


def problem(points: np.ndarray, heat: float = 1.0, free: tuple[str, ...] = FREE) -> Descent:
    sheet = Sheet(points, np.ones(len(points)))
    return Descent.of(pf.BladePetal(**TRUTH), free, sheet, None, heat)


def descended(
    start: pf.BladePetal,
    points: np.ndarray,
    rounds: int,
    heat: float = 1.0,
    free: tuple[str, ...] = FREE,
    **options: float,
) -> DescentEnd:
    sheet = Sheet(points, np.ones(len(points)))
    made = Descent.of(start, free, sheet, None, heat)
    return descend(begun(made, start), rounds, **options)


def test_the_gradient_is_that_of_differences():
    with jax.enable_x64(True):
        made = problem(cloud(0))
        here = made.start(pf.BladePetal(**TRUTH))
        z = here.z + 0.02 * np.random.default_rng(1).normal(size=len(here.z))
        here = made.search(made.evaluate(z, here.places))
        here = made.evaluate(z, here.places)
        for k in range(len(z)):
            step = 1e-5 * np.eye(len(z))[k]
            up, down = (made.evaluate(z + sign * step, here.places).cost for sign in (1, -1))
            assert here.gradient[k] == pytest.approx((up - down) / 2e-5, rel=1e-3, abs=0.05)


@pytest.mark.parametrize("heat", [1.0, 7.0])
def test_ends_do_not_depend_on_the_start(heat):
    points = cloud(2)
    ends = []
    with jax.enable_x64(True):
        for factor, angle in ((1.0, 0.0), (1.06, 0.15), (0.95, -0.2)):
            near = {
                "length": 2.0 * factor,
                "width": 0.6,
                "bend": 0.9 + angle,
                "cup_mid": 0.6 - angle,
            }
            start = pf.BladePetal(**near)
            ends.append(descended(start, points, 100, heat))
    assert all(end.moved <= 0.2 for end in ends)
    chi2 = [end.chi2 for end in ends]
    assert np.ptp(chi2) < 0.3 * heat
    error = np.sqrt(heat * np.diag(np.linalg.inv(ends[0].end().information)))
    values = np.array([[float(getattr(end.model, name)) for name in FREE] for end in ends])
    assert np.all(np.abs(values - values[0]) < 0.5 * error)


def test_it_says_how_far_it_is_when_it_has_no_more_rounds():
    points = cloud(3)
    with jax.enable_x64(True):
        far = pf.BladePetal(length=2.3, width=0.5, bend=0.4)
        end = descended(far, points, 2)
    assert end.rounds == 3  # with the evaluation of the start
    assert end.moved > 1


def test_it_leaves_a_start_that_will_not_reach_another_end():
    points = cloud(4)
    with jax.enable_x64(True):
        # A blade too stiff to follow the cloud: of all parameters only its length is free.
        stiff = pf.BladePetal(length=2.0, width=0.6)
        alone = descended(stiff, points, 60, free=("length",))
        beside = descended(stiff, points, 60, free=("length",), least=alone.chi2 - 1e4)
    assert beside.rounds <= alone.rounds
    assert beside.chi2 > alone.chi2 - 1e-6


def test_the_prior_moves_nothing_that_is_determined(monkeypatch):
    points = cloud(5, 1500)
    ends = []
    with jax.enable_x64(True):
        for strength in (solver.ALWAYS, 1e-3):
            monkeypatch.setattr(solver, "ALWAYS", strength)
            ends.append(descended(pf.BladePetal(**TRUTH), points, 100).end())
    values = np.array([[float(getattr(end.model, name)) for name in FREE] for end in ends])
    error = np.sqrt(np.diag(np.linalg.inv(ends[1].information)))
    typical = np.array([np.ptp(pf.parameters(pf.BladePetal)[n].typical) for n in FREE]) / 12**0.5
    determined = error < 0.3 * typical
    assert determined.sum() >= 6
    # Both ends may be short of their stationary points by a part of an error.
    moved = np.abs(values[0] - values[1]) / error
    assert np.all(moved[determined] < 0.1 + 0.2)


def test_a_parameter_stops_at_its_bound():
    rng = np.random.default_rng(6)
    mesh = pf.BladePetal(length=2.0, tip_width=0.0, tip_taper=1.0).mesh((161, 161))
    points = np.asarray(trimesh.sample.sample_surface(mesh, 700, seed=6)[0])
    points += rng.normal(0, NOISE, points.shape)
    with jax.enable_x64(True):
        end = descended(pf.BladePetal(length=2.0, tip_width=0.2), points, 100)
    assert end.moved <= 0.2
    assert 0 <= float(end.model.tip_width) < 0.1
