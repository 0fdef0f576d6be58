"""The blade against a restatement that integrates finely, and the laws that its parameters promise."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy.integrate import quad_vec

import petalfit as pf

BLADE = pf.BladePetal(
    length=12.0,
    width=0.7,
    widest=0.45,
    base_width=0.25,
    tip_width=0.1,
    base_taper=1.4,
    tip_taper=0.7,
    tip_edge=0.08,
    base_edge=-0.05,
    skew=0.15,
    bend=1.4,
    bend_shift=0.4,
    tip_roll=-0.3,
    sickle=0.2,
    twist=0.3,
    cup_base=0.8,
    cup_mid=0.6,
    cup_tip=-0.3,
    margin_curl=0.4,
    keel=0.0,
)


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def outline(p, u, v):
    if v < p.widest:
        xi, end, taper = (p.widest - v) / p.widest, p.base_width, p.base_taper
    else:
        xi, end, taper = (v - p.widest) / (1 - p.widest), p.tip_width, p.tip_taper
    w = end + (1 - end) * ((1 - xi**2 + 0.01) / 1.01) ** taper
    q = p.length * p.width * w * (u + p.skew * u**2)
    sigma = 2 * q / (p.length * p.width)
    edges = p.base_edge * (1 - v) ** 2 - p.tip_edge * v**2
    s = p.length * (v + edges * sigma**2)
    return q, s


def place(p, u, v):
    """Steps 1 to 3 with integrals to 1e-12 and matrices for rotations."""
    q, s = outline(p, u, v)

    def frame(x):
        out = p.bend * x + 2 * p.bend_shift * x * (x - 1) + p.tip_roll * x**8
        side = p.sickle * x
        tip_up = np.array([
            [1, 0, 0],
            [0, np.cos(out), -np.sin(out)],
            [0, np.sin(out), np.cos(out)],
        ])  # fmt: skip
        sideways = np.array([
            [np.cos(side), np.sin(side), 0],
            [-np.sin(side), np.cos(side), 0],
            [0, 0, 1],
        ])  # fmt: skip
        return tip_up @ sideways

    x, sigma = s / p.length, 2 * q / (p.length * p.width)
    midrib, _ = quad_vec(lambda s: frame(s / p.length)[:, 1], 0, s, epsabs=1e-12)
    turn = p.twist * x
    about = np.array([
        [np.cos(turn), 0, -np.sin(turn)],
        [0, 1, 0],
        [np.sin(turn), 0, np.cos(turn)],
    ])  # fmt: skip
    here = frame(x) @ about
    # The parabola through the three cups.
    cup = np.polyval(np.polyfit([0, 0.5, 1], [p.cup_base, p.cup_mid, p.cup_tip], 2), x)

    def direction(c):
        angle = cup * c + p.margin_curl * c**3 + p.keel * np.tanh(c / 0.12)
        return np.array([np.cos(angle), np.sin(angle)])

    half = 0.5 * p.length * p.width
    (across, up), _ = quad_vec(lambda c: half * direction(c), 0, sigma, epsabs=1e-12)
    return midrib + across * here[:, 0] + up * here[:, 2]


def test_equation():
    rng = np.random.default_rng(0)
    for u, v in zip(rng.uniform(-0.5, 0.5, 40), rng.uniform(0, 1, 40), strict=True):
        # Seven nodes integrate smooth angles to nine digits; x⁸ of the rolled tip is the roughest.
        np.testing.assert_allclose(BLADE(u, v), place(BLADE, u, v), atol=2e-6)
    keeled = dataclasses.replace(BLADE, keel=0.5)
    np.testing.assert_allclose(keeled(0.4, 0.5), place(keeled, 0.4, 0.5), atol=0.05)


def test_bending_stretches_nothing():
    """The midrib and the sections keep the lengths that they have flat."""
    v = np.linspace(0, 1, 2001)
    midrib = np.asarray(BLADE(np.zeros_like(v), v))
    assert np.linalg.norm(np.diff(midrib, axis=0), axis=1).sum() == pytest.approx(12.0, rel=1e-5)
    plain = dataclasses.replace(BLADE, tip_edge=0.0, base_edge=0.0)
    u = np.linspace(-0.5, 0.5, 2001)
    section = np.asarray(plain(u, np.full_like(u, 0.45)))
    width = np.linalg.norm(np.diff(section, axis=0), axis=1).sum()
    assert width == pytest.approx(12.0 * 0.7, rel=1e-4)


def test_a_blade_turned_over_is_the_same_blade():
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(0, 1, 9))
    other = np.asarray(BLADE.turned_over()(-u, v)) * [-1.0, 1.0, -1.0]
    np.testing.assert_allclose(other, BLADE(u, v), atol=1e-12)


def test_relief_stands_on_the_normal_of_the_bent_blade():
    raised = dataclasses.replace(
        BLADE, relief=True, midrib=0.3, rib_amplitude=0.1, ruffle=0.4, ruffle_phase=0.1
    )
    u, v = np.meshgrid(np.linspace(-0.45, 0.45, 7), np.linspace(0.1, 0.9, 7))
    lift = np.asarray(raised(u, v)) - np.asarray(BLADE(u, v))
    t = 2 * u
    height = 0.3 * (1 - v) ** 2 * np.exp(-((t / 0.08) ** 2))
    ribs = (1 - 2 * np.abs(v - 0.5)) * (1 - np.abs(t)) * np.sin(12 * np.pi * (u + 0.5))
    height += 0.1 * ribs + 0.4 * t**2 * v * np.cos(2 * np.pi * (3 * v + 0.1))
    np.testing.assert_allclose(np.sum(lift * BLADE.normal(u, v), axis=-1), height, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(lift, axis=-1), np.abs(height), atol=1e-9)


def test_gradients_are_those_of_finite_differences():
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 5), np.linspace(0, 1, 5))
    total = jax.jit(lambda blade: (blade(u, v) ** 2).mean())
    slope = jax.jit(jax.grad(total))(BLADE)
    for name, parameter in pf.parameters(BLADE).items():
        if parameter.fixed:
            continue
        h = 1e-5
        high, low = (
            float(total(dataclasses.replace(BLADE, **{name: getattr(BLADE, name) + s * h})))
            for s in (1, -1)
        )
        assert float(getattr(slope, name)) == pytest.approx((high - low) / (2 * h), abs=1e-5), name


def test_at_most_twenty_parameters_are_free():
    assert sum(not p.fixed for p in pf.parameters(pf.BladePetal).values()) <= 20
