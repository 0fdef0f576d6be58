"""A fit can be watched, and ended, and is not changed by it."""

import numpy as np
import pytest
import trimesh

import petalfit as pf
from petalfit.fitting.solver.observer import Glimpse, looking_on

PETAL = pf.PeonyPetal(a_x=12.0, b_y=25.0, dx=0.3)


def watched(target, **options):
    seen: list[Glimpse] = []
    with looking_on(seen.append):
        result = pf.fit_petal(target, **options)
    return result, seen


def test_rounds_are_shown_and_change_nothing():
    cloud = PETAL.sample(1500, seed=3, noise=0.05)
    result, seen = watched(cloud)
    count = len(seen)
    assert count >= 3
    assert pf.fit_petal(cloud).values == result.values
    assert len(seen) == count, "nobody looks on any more"
    last = seen[-1]
    # The last round comes before the bias is taken off.
    for name, error in result.stderr.items():
        assert abs(float(getattr(last.model, name)) - result.values[name]) < 3 * error
    # Distances are those of the points to the mesh, which is not quite the surface.
    mesh = last.model.mesh((129, 129))
    _, closest, _ = trimesh.proximity.closest_point_naive(mesh, last.points[:40])
    assert np.abs(np.abs(last.distances[:40]) - closest).max() < 0.02
    assert np.std(last.distances) < np.std(seen[0].distances)


def test_a_spline_is_shown_too():
    _, seen = watched(PETAL.sample(1500, seed=3), model=pf.SplinePetal)
    assert len(seen) > 5
    assert np.abs(seen[-1].distances).mean() < np.abs(seen[0].distances).mean()


def test_whoever_looks_on_can_end_it():
    class Enough(Exception):
        pass

    def leave(_):
        raise Enough

    with pytest.raises(Enough), looking_on(leave):
        pf.fit_petal(PETAL.sample(1500, seed=3, noise=0.05))
