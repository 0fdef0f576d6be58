"""sRGB, palettes and the patterns of Eqs. 9 and 10, against plain numpy restatements."""

import jax
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import petalfit as pf
from petalfit.colours import from_hex, to_hex, to_linear, to_srgb


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def grid(n=33):
    return np.meshgrid(np.linspace(-0.5, 0.5, n), np.linspace(0, 1, n), indexing="ij")


def radial(p, u, v):
    return p.i_1 + p.i_2 * np.sin(v * np.pi * p.f + p.phi) ** int(p.n)


def rib(p, u, v):
    wave = np.sin(p.f * (u + 0.5) * np.pi)
    return p.i_1 + p.i_2 * wave * (1 - v) ** p.n_1 * v**p.n_2 * (1 - 2 * np.abs(u)) ** p.k


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_the_radial_pattern_is_equation_9_for_whole_n(n):
    """Below zero too, where phases of -1 and two half waves lead."""
    u, v = grid()
    pattern = pf.RadialPattern(i_1=0.1, i_2=0.7, n=float(n), f=2.3, phi=-1.0)
    np.testing.assert_allclose(pattern(u, v), radial(pattern, u, v), atol=1e-12)


def test_between_whole_n_it_is_the_real_part_of_the_power():
    u, v = grid()
    pattern = pf.RadialPattern(i_1=0.1, i_2=0.7, n=2.4, f=2.3, phi=-1.0)
    base = np.sin(v * np.pi * 2.3 - 1.0).astype(complex)
    np.testing.assert_allclose(pattern(u, v), 0.1 + 0.7 * (base**2.4).real, atol=1e-12)


def test_the_rib_pattern_is_equation_10():
    u, v = grid()
    pattern = pf.RibPattern(i_1=0.2, i_2=0.5, f=9.0, n_1=0.7, n_2=1.3, k=0.4)
    np.testing.assert_allclose(pattern(u, v), rib(pattern, u, v), atol=1e-12)
    flat = pf.RibPattern(n_1=0.0, n_2=0.0, k=0.0)
    np.testing.assert_allclose(flat(u, v), rib(flat, u, v), atol=1e-12)


@pytest.mark.parametrize(
    "pattern",
    [
        pf.RadialPattern(i_1=0.1, i_2=0.7, n=2.4, f=1.3, phi=0.2),
        pf.RibPattern(n_1=0.7, n_2=1.3, k=0.4),
    ],
    ids=["between", "ribs"],
)
def test_gradients_are_finite_and_those_of_finite_differences(pattern):
    u, v = grid()

    def total(pattern):
        return (pattern(u, v) ** 2).mean()

    slope = jax.jit(jax.grad(total))(pattern)
    h = 1e-6
    for name in pf.parameters(pattern):
        high, low = (
            float(total(type(pattern)(**vars(pattern) | {name: getattr(pattern, name) + s * h})))
            for s in (1, -1)
        )
        assert float(getattr(slope, name)) == pytest.approx((high - low) / (2 * h), abs=1e-7)


@pytest.mark.parametrize(
    "pattern", [pf.RadialPattern(n=0.5), pf.RibPattern()], ids=["radial", "rib"]
)
def test_gradients_are_finite_where_a_root_begins(pattern):
    """At edges and nodes, where the base of a power is 0."""
    u, v = grid()
    slopes = jax.grad(lambda p, u, v: p(u, v).sum(), argnums=(0, 1, 2))(pattern, u, v)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
@example([0.04045, np.nextafter(0.04045, 0), np.nextafter(0.04045, 1)])
def test_srgb_and_linear_light_are_inverse(colour):
    srgb = np.array(colour)
    np.testing.assert_allclose(to_srgb(to_linear(srgb)), srgb, atol=1e-9)
    assert to_hex(from_hex(to_hex(srgb))) == to_hex(srgb)


def test_middle_grey_is_a_fifth_of_the_light():
    assert float(to_linear(np.array(0.5))) == pytest.approx(0.21404, abs=1e-5)
    assert float(to_srgb(np.array(0.18))) == pytest.approx(0.46136, abs=1e-5)


def test_a_colour_mixes_its_palette_in_linear_light():
    half = pf.RadialPattern(i_1=0.5, i_2=0.0)
    colour = pf.Colour.of("#000000", "#ffffff", patterns=(half,))
    np.testing.assert_allclose(colour(0.1, 0.3), [0.5] * 3)
    assert (colour.texture((4, 4)) == 188).all()  # sRGB of half the light
    # Intensities beyond [0, 1] do not.
    loud = pf.Colour.of("#000000", "#204060", patterns=(pf.RadialPattern(i_1=7.0),))
    np.testing.assert_allclose(loud(0.0, 0.5), to_linear(from_hex("#204060")))
    plain = pf.Colour.of("#204060")
    assert plain(np.zeros((2, 1)), np.zeros(3)).shape == (2, 3, 3)


def test_a_texture_has_the_tip_on_top():
    tip = pf.RadialPattern(i_1=0.0, i_2=1.0, n=8.0, f=0.5, phi=0.0)  # only near v = 1
    picture = pf.Colour.of("#000000", "#ffffff", patterns=(tip,)).texture((32, 16))
    assert picture.shape == (32, 16, 3)
    assert picture[0].min() > 250
    assert picture[-1].max() < 5


def test_a_palette_has_a_colour_for_every_pattern():
    with pytest.raises(
        ValueError, match="a ground and a colour for every pattern, 2 here; received 1"
    ):
        pf.Colour.of("#ffffff", patterns=(pf.RadialPattern(),))
    with pytest.raises(ValueError, match="like '#c2185b'; received 'red'"):
        pf.Colour.of("red")
