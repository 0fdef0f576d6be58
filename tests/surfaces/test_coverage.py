"""Coverage against shapely's union of all triangles, and against closed forms."""

import numpy as np
import pytest
import shapely

from petalfit.components import PeonyPetal
from petalfit.observations import Camera, TargetError
from petalfit.surfaces import Cylinder, Ellipsoid, Rectangle
from petalfit.surfaces.silhouette import coverage, silhouette

VIEWS = {
    "front": Camera.look_at((0, 12, 60), (0, 12, 0), (96, 128), pixels_per_unit=2.0),
    "oblique": Camera.look_at((30, -10, 60), (0, 15, 0), (96, 128)),
    "grazing": Camera.look_at((60, -10, 5), (0, 15, 0), (96, 128)),
    "cropped": Camera.look_at((30, -10, 60), (10, 25, 0), (48, 64), field_of_view=0.3),
}


@pytest.mark.parametrize("view", VIEWS)
def test_every_pixel_equals_the_union_of_all_triangles(view):
    camera, petal, resolution = VIEWS[view], PeonyPetal(dy=5.0), (33, 17)
    mask = silhouette(petal, camera, resolution).mask
    mesh = petal.mesh(resolution)
    triangles = camera.project(np.asarray(mesh.vertices))[mesh.faces]
    union = shapely.union_all(shapely.polygons(triangles))
    row, column = np.mgrid[: mask.shape[0], : mask.shape[1]]
    pixels = shapely.box(column, row, column + 1, row + 1)
    expected = shapely.area(shapely.intersection(union, pixels))
    np.testing.assert_allclose(mask, expected, atol=1e-9)


def test_solids_are_as_large_as_they_should_be():
    camera = Camera.look_at((0, 0, 9), (0, 0, 0), (200, 200), pixels_per_unit=30.0)
    assert silhouette(Ellipsoid(2.0, 3.0, 1.0), camera).area == pytest.approx(
        900 * np.pi * 6, rel=1e-3
    )
    assert silhouette(Cylinder(1.0, 3.0), camera).area == pytest.approx(900 * 6, rel=1e-3)
    # A wall that is seen through its open end covers a ring, and no more.
    along = Camera.look_at((0, 9, 0), (0, 0, 0), (200, 200), up=(0, 0, 1), field_of_view=0.5)
    ring = silhouette(Cylinder(1.0, 3.0), along)
    assert ring.mask[100, 100] == 0
    scale = 100 / np.tan(0.25)
    assert ring.area == pytest.approx(np.pi * (scale / 6) ** 2 - np.pi * (scale / 9) ** 2, rel=1e-2)


def test_coverage_of_a_shape_with_a_hole_that_leaves_the_image():
    outer = np.array([[-5, 1.5], [3.25, 1.5], [3.25, 9], [-5, 9], [-5, 1.5]], float)
    hole = np.array([[1, 2], [1, 3.5], [2, 3.5], [2, 2], [1, 2]], float)
    expected = np.zeros((5, 6))
    expected[1:, :3], expected[1:, 3] = 1, 0.25
    expected[1] *= 0.5
    expected[2:4, 1] = [0, 0.5]
    np.testing.assert_allclose(coverage([outer, hole], (5, 6)), expected, atol=1e-12)


def test_the_method_and_its_camera():
    camera = VIEWS["oblique"]
    seen = Rectangle(10.0, 20.0).silhouette(camera)
    assert seen.camera is camera
    corners = camera.project(np.array([[-5, 0, 0], [5, 0, 0], [5, 20, 0], [-5, 20, 0.0]]))
    assert seen.area == pytest.approx(shapely.Polygon(corners).area, rel=1e-9)


@pytest.mark.parametrize(
    ("eye", "target", "match"),
    [
        ((0, 0, 60), (0, 0, 100), "looks away"),
        ((0, 10, 0.5), (5, 30, 0.5), "stands in or beside"),
        ((0, 0, 60), (60, 0, 0), "blank"),
    ],
)
def test_cameras_that_do_not_see_the_surface(eye, target, match):
    with pytest.raises(TargetError, match=match):
        Rectangle(10.0, 20.0).silhouette(Camera.look_at(eye, target, (64, 64), field_of_view=0.4))
