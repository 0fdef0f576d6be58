"""Outlines against shapely's union of all triangles, and against closed forms."""

import jax
import numpy as np
import pytest
import shapely

from petalfit.components import PeonyPetal
from petalfit.observations import Camera
from petalfit.surfaces import Ellipsoid, outline
from petalfit.surfaces.outline import PLACES, rims_and_folds, sheets

VIEWS = {
    "front": Camera.look_at((0, 12, 60), (0, 12, 0), (192, 256), pixels_per_unit=4.0),
    "oblique": Camera.look_at((30, -10, 60), (0, 15, 0), (192, 256)),
    "grazing": Camera.look_at((60, -10, 5), (0, 15, 0), (192, 256)),
    "end-on": Camera.look_at((0, 80, 4), (0, 15, 0), (192, 256), pixels_per_unit=6.0),
}
PETAL = PeonyPetal(dy=5.0, rib_amplitude=0.5)


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def projected(camera, resolution):
    mesh = PETAL.mesh(resolution)
    return camera.project(np.asarray(mesh.vertices)), np.asarray(mesh.faces)


@pytest.mark.parametrize("view", VIEWS)
def test_sheets_are_the_triangles_that_cover_a_place(view):
    xy, faces = projected(VIEWS[view], (17, 13))
    rng = np.random.default_rng(0)
    places = rng.uniform(xy.min(axis=0) - 2, xy.max(axis=0) + 2, (400, 2))
    triangles = shapely.polygons(xy[faces])
    covering = shapely.contains_xy(triangles[:, None], *places.T).sum(axis=0)
    edges = rims_and_folds(xy.reshape(17, 13, 2))
    np.testing.assert_array_equal(sheets(places, xy, edges), covering)
    # A surface that is seen edge-on encloses no cells to count sheets in.
    assert len(sheets(places[:0], xy, edges)) == 0
    assert covering.max() >= (1 if view in ("front", "oblique") else 2)


@pytest.mark.parametrize("view", VIEWS)
def test_places_lie_on_the_edge_of_what_is_covered(view):
    camera = VIEWS[view]
    seen = outline(PETAL, camera)
    xy, faces = projected(camera, (161, 97))
    # Rounding leaves slits between neighbouring triangles, which a little swelling closes.
    union = shapely.union_all(shapely.polygons(xy[faces])).buffer(1e-3).buffer(-1e-3)
    off = shapely.distance(shapely.boundary(union), shapely.points(seen.place))
    assert len(off) == PLACES
    # Where folds end in cusps, a mesh puts a place on the wrong side of one.
    assert np.mean(off < 0.1) > 0.98
    assert off.max() < 1.0
    assert seen.length.sum() == pytest.approx(shapely.length(union), rel=0.06)
    good = off < 0.05
    reach = 0.2 * seen.normal[good]
    outside = shapely.contains_xy(union, *(seen.place[good] + reach).T)
    inside = shapely.contains_xy(union, *(seen.place[good] - reach).T)
    assert np.mean(~outside) > 0.98
    assert np.mean(inside) > 0.95
    np.testing.assert_allclose(np.linalg.norm(seen.normal, axis=1), 1.0)


@pytest.mark.parametrize("view", VIEWS)
def test_uv_and_places_belong_together(view):
    camera = VIEWS[view]
    seen = outline(PETAL, camera)
    places = camera.project(np.asarray(PETAL(*seen.uv.T)))
    np.testing.assert_allclose(places, seen.place, atol=1e-9)


def test_the_outline_of_a_ball_is_a_circle():
    camera = Camera.look_at((3, 4, 9), (0, 0, 0), (200, 200), pixels_per_unit=30.0)
    seen = outline(Ellipsoid(2.0, 2.0, 2.0), camera)
    offset = seen.place - 100.0
    # Some places lie on the seam, where that crosses the outline.
    off = np.abs(np.linalg.norm(offset, axis=1) - 60.0)
    assert np.mean(off < 1e-6) > 0.95
    assert off.max() < 0.06
    np.testing.assert_allclose(np.sum(offset * seen.normal, axis=1)[off < 1e-6], 60.0, atol=1e-3)
