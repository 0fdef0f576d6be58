"""Measures of sheets, compared with formulas for bent rectangles and with a fine mesh."""

import math

import numpy as np
import pytest

import petalfit as pf
from petalfit.surfaces import measures, nodes

# A strip 4 long and 1 wide: a taper of 0 leaves its sides straight.
STRIP = {
    "length": 4.0,
    "width": 0.25,
    "base_width": 1.0,
    "tip_width": 1.0,
    "base_taper": 1.0,
    "tip_taper": 1.0,
}


def measured(blade: pf.BladePetal) -> dict[str, float]:
    u, v = nodes(blade.domain)
    found = measures(np.asarray(blade(u, v))[None], blade.orientation)
    return {name: float(value[0]) for name, value in found._asdict().items()}


def test_a_flat_strip():
    found = measured(pf.BladePetal(**STRIP))
    expected = {"length": 4, "width": 1, "area": 4, "perimeter": 10, "chord": 4}
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-6)
    assert [found[name] for name in ("bend", "cup", "twist")] == pytest.approx([0, 0, 0], abs=1e-6)


@pytest.mark.parametrize("bend", [-2.5, 0.7, 3.0])
def test_a_strip_bent_to_an_arc(bend):
    found = measured(pf.BladePetal(**STRIP, bend=bend))
    assert found["length"] == pytest.approx(4, rel=1e-4)
    assert found["bend"] == pytest.approx(bend, rel=1e-3)
    assert found["chord"] == pytest.approx(8 / abs(bend) * math.sin(abs(bend) / 2), rel=1e-4)
    assert found["area"] == pytest.approx(4, rel=1e-4)


@pytest.mark.parametrize("cup", [-1.2, 0.8])
def test_a_strip_bent_to_a_gutter(cup):
    found = measured(pf.BladePetal(**STRIP, cup_base=cup, cup_mid=cup, cup_tip=cup))
    # Each margin has turned by the cup from the midrib.
    assert found["cup"] == pytest.approx(2 * cup, rel=1e-3)
    assert found["width"] == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("twist", [-0.9, 0.4])
def test_a_twisted_strip(twist):
    assert measured(pf.BladePetal(**STRIP, twist=twist))["twist"] == pytest.approx(twist, rel=1e-3)


def test_a_petal_of_no_special_shape():
    blade = pf.BladePetal(widest=0.4, bend=1.0, cup_mid=0.6, twist=0.2, skew=0.1, tip_edge=0.1)
    mesh = blade.mesh((257, 257))
    found = measured(blade)
    assert found["area"] == pytest.approx(mesh.area, rel=1e-3)
    v = np.linspace(0, 1, 2001)
    u = np.linspace(-0.5, 0.5, 401)
    grid = np.asarray(blade(*np.meshgrid(u, v, indexing="ij")), float)
    # At right angles to the lines of constant u: the area of a strip, divided by its length.
    across, along = np.diff(grid, axis=0), np.gradient(grid, axis=1)
    along = 0.5 * (along[1:] + along[:-1])
    strips = np.linalg.norm(np.cross(across, along), axis=-1)
    widths = (strips / np.linalg.norm(along, axis=-1)).sum(axis=0)
    steps = np.linalg.norm(np.diff(grid[200], axis=0), axis=-1)
    assert found["length"] == pytest.approx(steps.sum(), rel=1e-4)
    assert found["width"] == pytest.approx(widths.max(), rel=1e-3)
    k = int(np.argmax(widths))
    assert found["width_at"] == pytest.approx(steps[:k].sum() / steps.sum(), abs=0.01)
    rim = [grid[0], grid[-1], grid[:, 0], grid[:, -1]]
    around = sum(np.linalg.norm(np.diff(side, axis=0), axis=-1).sum() for side in rim)
    assert found["perimeter"] == pytest.approx(around, rel=2e-3)
