"""model="auto": the family that made the data, or the one that follows them."""

from pathlib import Path

import jax
import numpy as np
import pytest

import petalfit as pf
from petalfit.compilation import ExecutableStore, use_store
from petalfit.fitting.families.blade.family import BladeFamily
from petalfit.fitting.request.configuration import configuration
from petalfit.synthetic import random_petal

from .conftest import random_blade

PETALS = Path(__file__).parents[3] / "shared" / "data" / "petals"


def random_sheet(rng: np.random.Generator) -> pf.SplinePetal:
    """Arched and dented."""
    offsets, x = np.zeros((10, 10, 3)), np.linspace(-1, 1, 10)
    along, across = rng.uniform(-3, 3), rng.uniform(-2, 2)
    offsets[..., 2] = along * x**2 + across * x[:, None] ** 2
    offsets[..., 2] += 0.35 * rng.standard_normal((10, 10))
    offsets[..., :2] = 0.25 * rng.standard_normal((10, 10, 2))
    return pf.SplinePetal(a_x=6.0, b_y=10.0, c_z=0.0, offsets=offsets)


def picked(seed: int) -> tuple[str, pf.FitResult]:
    """The family of a cloud, and the result."""
    rng = np.random.default_rng(700 + seed)
    model = (random_petal, random_blade, random_sheet)[seed % 3](rng)
    noise = 0.05 if isinstance(model, pf.PeonyPetal) else 0.03
    points = model.sample(2000, seed=seed, noise=noise).points
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    points = points @ (q * np.linalg.det(q)).T + rng.uniform(-30, 30, 3)
    return type(model).__name__, pf.fit_petal(points, model="auto", pose="rigid", throw=False)


@pytest.mark.slow
def test_nineteen_of_twenty_families_are_picked():
    pairs = [picked(seed) for seed in range(20)]
    assert sum(type(result.model).__name__ == family for family, result in pairs) >= 19


@pytest.mark.slow
@pytest.mark.skipif(not PETALS.is_dir(), reason="third-party petals are not in the project")
def test_real_petals_are_no_peonies():
    for path in sorted(PETALS.glob("*.ply"))[::3]:
        cloud = pf.PointCloud.load(path, n=2000)
        result = pf.fit_petal(cloud, model="auto", pose="similarity", throw=False)
        assert not isinstance(result.model, pf.PeonyPetal), path.name


def test_what_cannot_be_compared_is_refused():
    cloud = pf.PeonyPetal().sample(300)
    with pytest.raises(pf.TargetError, match="neither free nor init"):
        pf.fit_petal(cloud, model="auto", free=["a_x"])
    with pytest.raises(pf.TargetError, match="one cloud"):
        pf.fit_petal([cloud, cloud], model="auto")


def test_programs_of_a_blade_are_compiled_ahead():
    store = ExecutableStore(None)
    cloud = pf.BladePetal(length=30.0, bend=0.5).sample(600, seed=1, noise=0.03)
    with use_store(store), jax.enable_x64(True):
        family = BladeFamily()
        for wait in family.foresee(*configuration(pf.BladePetal, None, None), "similarity"):
            wait()
        ahead = set(store._loaded)
        pf.fit_petal(cloud, model=pf.BladePetal, pose="similarity")
    assert len(ahead) >= 6
    # What is left are small programs of traits.
    late = {like[0].__name__ for like in set(store._loaded) - ahead}
    assert late <= {"_position"}
