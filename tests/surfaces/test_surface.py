"""What follows from the map alone: normals, areas, samples, meshes; poles and kinks included."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from petalfit.components import PeonyPetal
from petalfit.surfaces import AbstractDeformedSurface, Cylinder, Domain, Ellipsoid, Rectangle

SURFACES = [
    Rectangle(3.0, 5.0, 0.5),
    Cylinder(2.0, 7.0),
    Ellipsoid(1.0, 3.0, 2.0),
    PeonyPetal(),
]
NORMAL = jax.jit(lambda surface, u, v: surface.normal(u, v))
POLES = [-math.pi / 2, math.pi / 2]


class Swollen(AbstractDeformedSurface):
    """An ellipsoid with a swelling along its normal, as the paper's receptacle is."""

    r: float
    domain = Ellipsoid.domain

    @property
    def base(self):
        return Ellipsoid(self.r, 3 * self.r, self.r)

    def height(self, u, v, point):
        return 0.5 * self.r * jnp.abs(jnp.sin(2 * u))


def grid(surface, n=13):
    """Places all over the domain, edges, poles and the middle (where kinks are) included."""
    u, v = (np.linspace(*side, n) for side in surface.domain)
    return (x.ravel() for x in np.meshgrid(u, v, indexing="ij"))


@pytest.mark.parametrize("surface", [*SURFACES, Swollen(1.5)], ids=lambda s: type(s).__name__)
def test_normals_are_unit_and_finite_and_so_are_all_derivatives(surface):
    with jax.enable_x64(True):
        u, v = grid(surface)

        def scalar(surface, u, v):
            total = jnp.sum(surface(u, v)) + jnp.sum(surface.area_element(u, v))
            return total, surface.normal(u, v)

        derivatives, normal = jax.jit(jax.grad(scalar, (0, 1, 2), has_aux=True))(surface, u, v)
        np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, rtol=1e-12)
        for derivative in jax.tree.leaves(derivatives):
            assert np.isfinite(derivative).all()


@pytest.mark.parametrize("surface", SURFACES, ids=lambda s: type(s).__name__)
def test_tangents_equal_finite_differences(surface):
    with jax.enable_x64(True):
        rng = np.random.default_rng(0)
        u, v = (
            rng.uniform(0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high, 50)
            for low, high in surface.domain
        )
        h = 1e-6

        @jax.jit
        def tangents_and_differences(surface):
            along_u = (surface(u + h, v) - surface(u - h, v)) / (2 * h)
            along_v = (surface(u, v + h) - surface(u, v - h)) / (2 * h)
            return surface.tangents(u, v), (along_u, along_v)

        tangents, differences = tangents_and_differences(surface)
        np.testing.assert_allclose(tangents, differences, atol=1e-6, rtol=1e-6)


@given(
    st.floats(0.1, 10),
    st.floats(0.1, 10),
    st.floats(0.1, 10),
    st.floats(*Ellipsoid.domain.u),
    st.floats(*Ellipsoid.domain.v),
)
def test_ellipsoid_normal_is_the_gradient_of_its_implicit_equation(r_x, r_y, r_z, u, v):
    with jax.enable_x64(True):
        surface = Ellipsoid(r_x, r_y, r_z)
        gradient = np.asarray(surface(u, v)) / np.array([r_x, r_y, r_z]) ** 2
        expected = gradient / np.linalg.norm(gradient)
        np.testing.assert_allclose(NORMAL(surface, u, v), expected, atol=1e-9)


@pytest.mark.parametrize("pole", POLES)
def test_normal_and_its_slope_at_a_pole_are_the_limits_from_inside(pole):
    with jax.enable_x64(True):
        surface = Ellipsoid(1.0, 3.0, 2.0)
        inside = pole - math.copysign(1e-5, pole)
        np.testing.assert_allclose(
            NORMAL(surface, pole, 0.7), [0, math.copysign(1.0, pole), 0], atol=1e-12
        )
        slope = jax.jit(jax.jacfwd(surface.normal))
        np.testing.assert_allclose(slope(pole, 0.7), slope(inside, 0.7), atol=1e-4)


def test_poles_are_safe_in_single_precision():
    # In float32, π/2 is rounded past the pole.
    normal = Ellipsoid(1.0, 3.0, 2.0).normal(np.float32(math.pi / 2), np.float32(0.3))
    np.testing.assert_allclose(normal, [0, 1, 0], atol=1e-6)


def test_cylinder_normal_points_outward_and_rectangle_normal_up():
    np.testing.assert_allclose(Cylinder(2.0, 5.0).normal(0.0, 0.5), [1, 0, 0], atol=1e-7)
    np.testing.assert_allclose(Rectangle(2.0, 5.0).normal(0.1, 0.5), [0, 0, 1], atol=1e-7)


@pytest.mark.parametrize(
    ("surface", "area"),
    [
        (Rectangle(3.0, 5.0), 15.0),
        (Cylinder(2.0, 7.0), 28 * math.pi),
        (Ellipsoid(1.5, 1.5, 1.5), 9 * math.pi),
    ],
    ids=["rectangle", "cylinder", "sphere"],
)
def test_area(surface, area):
    with jax.enable_x64(True):
        assert float(surface.area()) == pytest.approx(area, rel=1e-5)
        # The mesh is inscribed, and approaches the surface.
        coarse, fine = surface.mesh((33, 33)).area, surface.mesh((129, 129)).area
        assert abs(fine - area) <= abs(coarse - area) + 1e-9
        assert fine == pytest.approx(area, rel=2e-3)


def test_broadcasting_and_transformations():
    petal = PeonyPetal()
    assert petal(np.zeros((4, 1)), np.zeros(3)).shape == (4, 3, 3)
    batched = jax.vmap(lambda a_x: PeonyPetal(a_x=a_x)(0.2, 0.3))(jnp.array([10.0, 20.0]))
    np.testing.assert_allclose(batched[1], PeonyPetal(a_x=20.0)(0.2, 0.3), rtol=1e-6)
    np.testing.assert_allclose(jax.jit(lambda p: p(0.2, 0.3))(petal), petal(0.2, 0.3), rtol=1e-5)


@pytest.mark.parametrize("surface", SURFACES, ids=lambda s: type(s).__name__)
def test_samples_are_uniform_by_area(surface):
    n = 20_000
    cloud = surface.sample(n, seed=3)
    # Share of the points in slabs of y against the area of these slabs on a fine mesh.
    mesh = surface.mesh((513, 257))
    edges = np.quantile(cloud.points[:, 1], np.linspace(0, 1, 9)[1:-1])
    slab = np.digitize(mesh.triangles_center[:, 1], edges)
    share = np.bincount(slab, mesh.area_faces, minlength=8) / mesh.area
    counts = np.bincount(np.digitize(cloud.points[:, 1], edges), minlength=8)
    chi2 = np.sum((counts - n * share) ** 2 / (n * share))
    assert chi2 < 24.3  # 99.9 % of 7 degrees of freedom


def test_samples_repeat_and_carry_noise_and_normals():
    petal = PeonyPetal()
    first, again, other = (petal.sample(500, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.points, again.points)
    assert not np.array_equal(first.points, other.points)
    noisy = petal.sample(500, seed=1, noise=0.1)
    assert np.std(noisy.points - first.points) == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(np.linalg.norm(first.normals, axis=-1), 1.0)


@pytest.mark.parametrize(("n", "noise"), [(0, 0.0), (10, -1.0), (10, math.nan)])
def test_impossible_samples_are_refused(n, noise):
    with pytest.raises(ValueError, match="n must be at least 1"):
        PeonyPetal().sample(n, noise=noise)


@pytest.mark.parametrize("surface", SURFACES, ids=lambda s: type(s).__name__)
def test_mesh_has_uvs_and_faces_along_its_normals(surface):
    mesh = surface.mesh((33, 17))
    assert mesh.vertices.shape == (33 * 17, 3)
    uv = mesh.visual.uv
    assert uv.min() == 0
    assert uv.max() == 1
    solid = mesh.area_faces > 1e-9  # triangles at a pole have no area
    agree = np.sum(mesh.face_normals * mesh.vertex_normals[mesh.faces[:, 0]], axis=-1)
    assert np.mean(agree[solid] > 0) > 0.97  # but for the few across a sharp midrib


def test_mesh_of_too_low_resolution_is_refused():
    with pytest.raises(ValueError, match="at least 2 × 2"):
        PeonyPetal().mesh((1, 5))


def test_domain_is_shared_by_a_deformed_surface():
    assert PeonyPetal.domain == Domain(u=(-0.5, 0.5), v=(0.0, 1.0))
