"""One outline of a blade: it shows the outline, and nothing of the third dimension."""

import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.families.registry import family_of
from petalfit.fitting.inference.verdict import misfit_of
from petalfit.results import Agreement

from .conftest import random_blade

FREE = ("length", "width", "widest", "tip_width", "bend", "cup_mid", "twist")


@pytest.fixture(scope="module")
def leaf():
    return pf.BladePetal(length=20.0, width=0.45, widest=0.4, tip_width=0.05)


@pytest.fixture(scope="module")
def result(leaf):
    # A camera as the fit supposes it: x right, y down, the petal seen from the front.
    camera = pf.Camera.orthographic(np.diag([1.0, -1.0, -1.0]), 7.0, (80.0, 155.0), (160, 160))
    mask = np.asarray(leaf.silhouette(camera).mask) > 0.5
    return pf.fit_petal(mask, model=pf.BladePetal, free=FREE, throw=False)


def test_a_flat_leaf_stays_flat(result, leaf):
    assert result.converged
    for name in ("bend", "cup_mid", "twist"):
        assert not result.identifiable[name]
        assert abs(result.values[name]) < 1e-3
    for name in ("width", "widest"):
        assert result.identifiable[name]
        assert abs(result.values[name] - getattr(leaf, name)) < 0.02
    assert result.traits["length"].value == pytest.approx(140, abs=2)
    assert result.traits["length"].unit == "px"


def test_a_misfit_blames_no_camera_that_nobody_gave(result):
    (part,) = result.agreements
    far = Agreement(part.target, part.distances + 20.0, part.weights, part.noise)
    assert "camera" not in misfit_of(far, False, None, False)
    assert "another shape" in misfit_of(far, False, None, False)


def test_several_masks_and_clouds_hide_nothing():
    assert family_of(pf.BladePetal()).depth
    assert not family_of(pf.PeonyPetal()).depth


def _fits(back, seeds):
    """Bent blades, each seen in one mask with its camera, and the fits of these masks."""
    for seed in seeds:
        blade = random_blade(np.random.default_rng(seed))
        places = np.asarray(blade.mesh((33, 33)).vertices)
        middle = places.mean(axis=0)
        camera = pf.Camera.look_at(middle + back, middle, (200, 200), pixels_per_unit=1.0)
        scale = 160 / np.ptp(camera.project(places), axis=0).max()
        camera = pf.Camera.look_at(middle + back, middle, (200, 200), pixels_per_unit=scale)
        mask = np.asarray(blade.silhouette(camera).mask) > 0.5
        yield blade, pf.fit(pf.BladePetal, mask, camera=camera, throw=False)


@pytest.fixture(scope="module")
def bent():
    # Their bends hide 30 and 9 % of their lengths.
    front = _fits(np.array([0.0, 0.0, 1.0]), (5027, 5141))
    return [*front, *_fits(np.array([0.6, -0.8, 1.2]), (5109, 7100))]


def test_errors_allow_for_a_bend_that_one_outline_hides(bent):
    z = []
    for blade, result in bent:
        if not result.converged:
            assert result.status == "misfit"
            assert "it is bent (add masks from other directions" in result.reason
            continue
        names = [name for name in result.names if result.identifiable[name]]
        assert not set(names) & set(family_of(blade).depth)
        z += [(result.values[n] - getattr(blade, n)) / result.stderr[n] for n in names]
    assert len(z) >= 3
    assert np.mean(np.abs(z) < 1.96) > 0.8
    assert np.max(np.abs(z)) < 3
