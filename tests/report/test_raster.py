"""The depth buffer against what can be said of it without one."""

import io

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from petalfit.report.raster import Canvas, png

RED, BLUE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def rectangle(x, y, depth, rgb) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A flat 3 × 3 grid; `depth` is a function of x."""
    grid = np.stack(np.meshgrid(np.linspace(*x, 3), np.linspace(*y, 3), indexing="ij"), axis=-1)
    return grid, depth(grid[..., 0]), np.broadcast_to(rgb, (3, 3, 3)).copy()


def test_crossing_sheets_hide_each_other_where_they_should():
    canvas = Canvas((20, 100))
    canvas.sheet(*rectangle((0, 100), (0, 20), lambda x: x, RED))
    canvas.sheet(*rectangle((0, 100), (0, 20), lambda x: 100.0 - x, BLUE))
    left, right = canvas.rgba[:, :49], canvas.rgba[:, 51:]
    np.testing.assert_array_equal(left, np.broadcast_to([0, 0, 255, 255], left.shape))
    np.testing.assert_array_equal(right, np.broadcast_to([255, 0, 0, 255], right.shape))


@given(
    corners=arrays(np.float64, (2, 2, 2), elements=st.floats(-25, 25)),
    shape=st.tuples(st.integers(2, 5), st.integers(2, 5)),
)
def test_a_sheet_has_no_holes(corners, shape):
    """Every pixel well inside a convex quadrilateral is covered, whatever its shear."""
    base = np.array([[[30.0, 30.0], [30.0, 120.0]], [[120.0, 30.0], [120.0, 120.0]]])
    corners = base + corners
    around = corners[[0, 0, 1, 1], [0, 1, 1, 0]]
    sides = np.roll(around, -1, axis=0) - around
    x, y = sides.T
    # Of a quadrilateral that is not convex, the half planes of its sides are not the inside.
    assume(np.ptp(np.sign(x * np.roll(y, -1) - y * np.roll(x, -1))) == 0)
    u, v = (np.linspace(0, 1, n) for n in shape)
    weights = np.einsum("iu,jv->ijuv", np.stack([1 - u, u]), np.stack([1 - v, v]))
    xy = np.einsum("ijuv,ijc->uvc", weights, corners)
    canvas = Canvas((150, 150))
    canvas.sheet(xy, np.zeros(shape), np.broadcast_to(RED, (*shape, 3)).copy())
    x, y = np.meshgrid(np.arange(150) + 0.5, np.arange(150) + 0.5)
    inside = np.ones((150, 150), bool)
    outside = np.zeros((150, 150), bool)
    turn = np.sign(
        np.cross(np.append(around[1] - around[0], 0), np.append(around[2] - around[0], 0))[2]
    )
    for start, end in zip(around, np.roll(around, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        distance = turn * (along[0] * (y - start[1]) - along[1] * (x - start[0]))
        inside &= distance > 1.5
        outside |= distance < -1.5
    cover = canvas.rgba[..., 3] == 255
    assert cover[inside].all()
    assert not cover[outside].any()


@pytest.mark.parametrize("radius", [2.0, 3.3, 10.0])
def test_discs_are_round(radius):
    rng = np.random.default_rng(0)
    centres = rng.uniform(20, 80, (50, 2))
    areas = []
    for centre in centres:
        canvas = Canvas((100, 100))
        canvas.discs(centre[None], np.zeros(1), BLUE[None], radius)
        rows, columns = np.nonzero(canvas.rgba[..., 3])
        areas.append(len(rows))
        middle = np.array([columns.mean() + 0.5, rows.mean() + 0.5])
        np.testing.assert_allclose(middle, centre, atol=0.35)
    np.testing.assert_allclose(np.mean(areas), np.pi * radius**2, rtol=0.03)


def test_what_lies_outside_is_cut_off():
    canvas = Canvas((10, 30))
    xy = np.array([[-500.0, 5.0], [15.0, 5.0], [1e9, 5.0], [15.0, -1e9]])
    canvas.discs(xy, np.zeros(4), np.tile(RED, (4, 1)), 2.0)
    assert 0 < (canvas.rgba[..., 3] == 255).sum() < 20


@given(arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(4))))
def test_png_is_read_back_by_pillow(rgba):
    data = png(rgba)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), rgba)
    assert png(rgba) == data
