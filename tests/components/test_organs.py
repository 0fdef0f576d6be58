"""Every organ against a plain numpy restatement of its equation, and the laws that all surfaces obey."""

import dataclasses

import jax
import numpy as np
import pytest

import petalfit as pf

PI = np.pi


def cylinder(r, h, u, v):
    points = np.stack([r * np.cos(u), h * v, r * np.sin(u)], axis=-1)
    normals = np.stack([np.cos(u), np.zeros_like(u), np.sin(u)], axis=-1)
    return points, normals


def ellipsoid(r_x, r_y, r_z, u, v):
    unit = np.stack([np.cos(u) * np.cos(v), np.sin(u), np.cos(u) * np.sin(v)], axis=-1)
    points = unit * [r_x, r_y, r_z]
    normals = points / np.square([r_x, r_y, r_z])
    return points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def vector(x, y, z):
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)


def pedicel(p, u, v):
    points, n = cylinder(p.r, p.h, u, v)
    bend = p.a_2 * np.sin(PI * v)
    return points + n * (p.a_1 * np.sin(PI * v - 1))[..., None] + vector(bend, 0, bend)


def swollen(p, u, v):
    points, n = ellipsoid(p.r, 3 * p.r, p.r, u, v)
    swell = np.where(u >= 0, p.r / 2, p.r / 1.4) * np.abs(np.sin(2 * u))
    return points + n * swell[..., None]


def printed_bowl(p, u, v):
    down = np.where(u >= 0, -p.r * np.cos(PI / 2 - u), 0)
    return swollen(p, u, v) + vector(0, 0, down)


def bowl(p, u, v):
    return swollen(p, u, v) + vector(0, np.where(u >= 0, -5.5 * p.r * np.sin(u), 0), 0)


def ovary(p, u, v):
    points, _ = ellipsoid(p.r, 2 * p.r, p.r, u, v)
    return points + vector(0, 0, -p.r / 2 * np.sin(PI / 2 + u))


def style(p, u, v):
    points, n = cylinder(p.r, p.slenderness * p.r, u, v)
    swell = p.swell * np.sin(PI * v - 1)
    return points + n * swell[..., None] + vector(0, 0, p.bend * np.sin(PI * v))


def stigma(p, u, v):
    return ellipsoid(p.r, p.h, p.r, u, v)[0]


def anther(p, u, v):
    points, n = ellipsoid(p.r, 3 * p.r, p.r, u, v)
    return points + n * (p.swell * np.cos(u) * np.abs(np.cos(v)))[..., None]


def filament(p, u, v):
    points, n = cylinder(p.r, p.h, u, v)
    return points - n * (p.taper * v)[..., None] + vector(0, 0, p.a_2 * np.sin(PI * v / 2) ** 2)


def sepal(p, u, v):
    height = p.cup * (4 * u**2 - 1) + p.bend * v**2
    return vector(p.a_x * u * np.cos(p.c * v) ** 2, p.b_y * v, height)


def superellipse(p, u, v):
    c, s = np.cos(u), np.sin(u)
    scale = (c**4 + s**4) ** -0.25
    return vector(p.r * c * scale * np.cos(v), p.h / 2 * s * scale, p.r * c * scale * np.sin(v))


def cone(p, u, v):
    w = 1 - 2 * np.abs(u) / PI
    y = np.where(u < 0, p.h * (w - 1), p.r * (1 - w**2) / 4)
    return vector(p.r * w * np.cos(v), y, p.r * w * np.sin(v))


ORGANS = {
    "pedicel": (pf.Pedicel(), pedicel),
    "bowl": (pf.Bowl(), bowl),
    "bowl as printed": (pf.Bowl(hollow="printed"), printed_bowl),
    "ovary": (pf.Ovary(), ovary),
    "style": (pf.Style(), style),
    "stigma": (pf.Stigma(), stigma),
    "anther": (pf.Anther(), anther),
    "filament": (pf.Filament(), filament),
    "sepal": (pf.Sepal(), sepal),
    "cylinder": (pf.CylinderReceptacle(), superellipse),
    "cone": (pf.ConeReceptacle(), cone),
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


# Compiled as a whole, for one shape: one program for each organ.
PLACED = jax.jit(lambda surface, u, v: (surface(u, v), surface.normal(u, v)))


def grid(surface):
    return np.meshgrid(*(np.linspace(*side, 13) for side in surface.domain), indexing="ij")


@pytest.mark.parametrize("name", ORGANS)
def test_equations(name):
    surface, formula = ORGANS[name]
    u, v = grid(surface)
    points, _ = PLACED(surface, u, v)
    np.testing.assert_allclose(points, formula(surface, u, v), atol=1e-12)


@pytest.mark.parametrize("name", ORGANS)
def test_normals_are_unit_and_outward(name):
    surface, formula = ORGANS[name]
    u, v = grid(surface)
    _, normals = PLACED(surface, u, v)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-9)
    # Against the cross product of central differences of the restatement, away from poles and kinks.
    (u_low, u_high), (v_low, v_high) = surface.domain
    rng = np.random.default_rng(0)
    u = rng.uniform(0.9 * u_low + 0.1 * u_high, 0.1 * u_low + 0.9 * u_high, u.shape)
    v = rng.uniform(0.9 * v_low + 0.1 * v_high, 0.1 * v_low + 0.9 * v_high, v.shape)
    h = 1e-5
    along_u = formula(surface, u + h, v) - formula(surface, u - h, v)
    along_v = formula(surface, u, v + h) - formula(surface, u, v - h)
    cross = surface.orientation * np.cross(along_u, along_v)
    cross /= np.linalg.norm(cross, axis=-1, keepdims=True)
    _, normals = PLACED(surface, u, v)
    agreement = np.sum(cross * np.asarray(normals), axis=-1)
    assert np.mean(agreement > 1 - 1e-6) > 0.98


@pytest.mark.parametrize("name", ORGANS)
def test_gradients_are_finite_and_equal_to_finite_differences(name):
    surface, formula = ORGANS[name]
    u, v = grid(surface)
    slope = jax.jit(jax.grad(lambda surface: (surface(u, v) ** 2).mean()))(surface)
    h = 1e-6
    for parameter in pf.parameters(surface):
        value = getattr(surface, parameter)
        high, low = (
            np.mean(formula(dataclasses.replace(surface, **{parameter: value + s * h}), u, v) ** 2)
            for s in (1, -1)
        )
        size = 1 + np.mean(formula(surface, u, v) ** 2)
        assert abs(getattr(slope, parameter) - (high - low) / (2 * h)) < 1e-6 * size


@pytest.mark.parametrize("name", ["ovary", "pedicel"])
def test_gradients_of_normals_are_finite(name):
    """At poles and seams too."""
    surface, _ = ORGANS[name]
    u, v = grid(surface)
    slope = jax.jit(jax.grad(lambda surface: surface.normal(u, v)[..., 0].sum()))(surface)
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(slope))


@pytest.mark.parametrize("name", ["stigma", "cylinder", "anther"])
def test_normals_of_solids_point_away_from_their_middle(name):
    surface, _ = ORGANS[name]
    u, v = grid(surface)
    points, normals = PLACED(surface, u, v)
    assert np.min(np.sum(normals * points, axis=-1)) > 0


def test_the_bowl_is_hollow_and_the_printed_one_is_not():
    """Along the axis, a bowl's upper side lies below its rim."""
    rim = np.asarray(pf.Bowl()(0.0, 0.0))[1]
    assert np.asarray(pf.Bowl()(PI / 2, 0.0))[1] < rim - 1.0
    assert np.asarray(pf.Bowl(hollow="printed")(PI / 2, 0.0))[1] > rim + 1.0
    # The inside stays within the wall.
    u = np.linspace(0.05, 1.4, 30)
    inner, outer = (np.asarray(pf.Bowl()(s * u, np.zeros(30))) for s in (1, -1))
    for x, y, _ in inner:
        beside = np.interp(y, outer[::-1, 1], outer[::-1, 0])
        assert x < beside
    with pytest.raises(ValueError, match="hollow must be"):
        pf.Bowl(hollow="deep")


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("sepal", "stigma") else pytest.param(name, marks=pytest.mark.slow)
        for name in ORGANS
        if name != "bowl as printed"
    ],
)
def test_an_organ_comes_back_from_its_own_cloud(name):
    """2,000 points with noise of half a percent; without a start."""
    kind = type(ORGANS[name][0])
    rng = np.random.default_rng(5)
    truth = {
        parameter: low + (high - low) * rng.uniform(0.3, 0.7)
        for parameter, p in pf.parameters(kind).items()
        if not p.fixed
        for low, high in [p.typical]
    }
    organ = kind(**truth)
    cloud = organ.sample(2000, seed=6)
    noise = 0.005 * cloud.diagonal
    result = pf.fit(kind, cloud.points + noise * rng.standard_normal((2000, 3)))
    assert result.noise == pytest.approx(noise, rel=0.08)
    for parameter, value in truth.items():
        assert result.identifiable[parameter]
        assert abs(result.values[parameter] - value) < 5 * result.stderr[parameter]
    assert not result.warnings


def test_a_style_has_the_printed_constants():
    assert (pf.Style().swell, pf.Style().bend, pf.Style().slenderness) == (1.0, 3.0, 10.0)
    constants = ("swell", "bend", "slenderness")
    assert all(pf.parameters(pf.Style)[name].fixed for name in constants)
