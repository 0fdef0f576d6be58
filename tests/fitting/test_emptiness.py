"""The size of a surface between its edges, and the cost of an outline that encloses empty places."""

import jax
import numpy as np
import pytest

import petalfit as pf
from petalfit.compilation import BLOCK, blocks
from petalfit.fitting.coordinates import Box
from petalfit.fitting.likelihood.emptiness import Emptiness
from petalfit.fitting.likelihood.spans import spans_of

FREE = ("length", "width", "widest", "tip_width", "tip_taper", "bend", "cup_mid", "twist")
BLADE = pf.BladePetal(length=2.0, width=0.6, tip_width=0.2, bend=0.9, cup_mid=0.6, twist=0.2)


def test_spans_are_those_of_the_mesh_and_their_slopes_those_of_differences():
    with jax.enable_x64(True):
        box = Box.of(BLADE, FREE)
        z = box.place(BLADE)
        spans, slopes, outline, moved = spans_of(box, z)
        assert float(spans.area) == pytest.approx(BLADE.mesh((201, 401)).area, rel=2e-3)
        for k in range(len(z)):
            step = 1e-5 * np.eye(len(z))[k]
            up, down = spans_of(box, z + step), spans_of(box, z - step)
            for before, after, slope in (
                *zip(down[0], up[0], slopes, strict=True),
                (down[2], up[2], np.moveaxis(np.asarray(moved), 0, 1)),
            ):
                change = (np.asarray(after) - np.asarray(before)) / 2e-5
                np.testing.assert_allclose(np.asarray(slope)[..., k], change, rtol=1e-4, atol=1e-6)
        assert np.asarray(outline).shape == (92, 3)


def test_an_outline_without_points_costs_and_is_pulled_back():
    points = BLADE.sample(1500, seed=1).points
    empty = Emptiness.of(points, np.ones(1500))
    with jax.enable_x64(True):
        box = Box.of(BLADE, FREE)
        z = box.place(BLADE)

        def cost(z):
            _, _, outline, moved = spans_of(box, z)
            return empty.cost(np.asarray(outline), np.asarray(moved), 0.01)

        assert cost(z)[0] < 1.0
        longer = z.copy()
        longer[0] += 0.8
        value, gradient, information = cost(longer)
        assert value > 10.0
        assert gradient[0] > 0
        assert np.linalg.eigvalsh(information).min() > -1e-9 * np.trace(information)
        for k in range(len(z)):
            step = 1e-6 * np.eye(len(z))[k]
            change = (cost(longer + step)[0] - cost(longer - step)[0]) / 2e-6
            assert gradient[k] == pytest.approx(change, rel=1e-3, abs=1e-3 * np.abs(gradient).max())


@pytest.mark.parametrize("count", [1, BLOCK, BLOCK + 1])
def test_blocks_hold_all_rows_and_padding(count):
    rows = np.arange(2.0 * count).reshape(count, 2)
    found = blocks(rows, -1.0)
    assert {len(block) for block in found} == {BLOCK}
    together = np.concatenate(found)
    np.testing.assert_array_equal(together[:count], rows)
    assert (together[count:] == -1.0).all()
