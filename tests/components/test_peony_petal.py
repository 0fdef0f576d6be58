"""Eqs. 7 and 8 against a plain restatement, and the declarations of the parameters."""

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from petalfit.components import PeonyPetal, parameters

U, V = np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(0, 1, 33), indexing="ij")


JACOBIAN = jax.jit(jax.jacfwd(lambda petal, u, v: petal(u, v)))


def restated(u, v, p):
    """The paper's equations, written down once more, with numpy and a loop over nothing."""
    pi = np.pi
    x = p["a_x"] * u + 0.8 * p["a_x"] * u * np.sin(pi * v / 2 - p["c"])
    y = p["b_y"] * v + (v - 0.5) * (
        1.5 * p["a_x"] * np.sin(pi * (u + 0.5))
        + np.abs(3 * v * np.sin(pi * p["a_x"] * (u + 0.5) / 6))
    )
    z = (
        p["c_z"]
        + p["rib_amplitude"]
        * (1 - 2 * np.abs(v - 0.5))
        * np.sin(p["rib_frequency"] * (u + 0.5) * pi)
        * (1 - 2 * np.abs(u))
        + p["midrib_height"] * (1 - v) ** 2 * np.exp(-p["midrib_sharpness"] * u**2)
        + p["dy"] * np.sin(pi * y / 40 - 1)
        + p["dx"] * np.sin(pi * x / 2 - 0.5)
        + p["tip_curl"] * v**3 * np.sin(pi * x / 8)
    )
    return np.stack([x, y, z], axis=-1)


def values(draw_from):
    return st.fixed_dictionaries(
        {name: st.floats(*getattr(p, draw_from)) for name, p in parameters(PeonyPetal).items()}
    )


@given(values("typical"))
def test_equals_the_printed_equations(p):
    with jax.enable_x64(True):
        scale = max(1.0, *(abs(x) for x in p.values() if x < 100))
        np.testing.assert_allclose(
            PeonyPetal(**p)(U, V), restated(U, V, p), atol=1e-12 * scale, rtol=1e-12
        )


@given(values("typical"), st.floats(-0.45, 0.45), st.floats(0.05, 0.95))
def test_derivatives_by_parameters_equal_finite_differences(p, u, v):
    with jax.enable_x64(True):
        jacobian = JACOBIAN(PeonyPetal(**p), u, v)
        for name in p:
            h = 1e-6 * max(1.0, abs(p[name]))
            high, low = (restated(u, v, p | {name: p[name] + s * h}) for s in (1, -1))
            slope = np.max(np.abs(high - low)) / (2 * h)
            # A kink of |·| may lie between the two points of the difference.
            if name == "a_x" and abs(np.sin(np.pi * p["a_x"] * (u + 0.5) / 6)) < 1e-4:
                continue
            np.testing.assert_allclose(
                getattr(jacobian, name), (high - low) / (2 * h), atol=1e-5 * max(1.0, slope)
            )


def test_default_constants_are_those_of_the_paper():
    petal = PeonyPetal()
    assert (petal.rib_frequency, petal.rib_amplitude, petal.midrib_height) == (20, 0.3, 3)
    assert (petal.midrib_sharpness, petal.tip_curl, petal.c_z) == (800, 2, 0)


def test_every_parameter_is_declared_once_and_soundly():
    declared = parameters(PeonyPetal)
    assert list(declared) == [field.name for field in dataclasses.fields(PeonyPetal)]
    assert [name for name, p in declared.items() if p.fixed] == ["midrib_sharpness"]
    for name, p in declared.items():
        assert p.bounds[0] < p.typical[0] < p.typical[1] < p.bounds[1], name
        assert p.bounds[0] < getattr(PeonyPetal(), name) < p.bounds[1], name
        assert p.unit in {"length", "rad", "1"}
        assert p.symbol
        assert p.meaning


def test_a_petal_is_an_immutable_pytree_of_its_parameters():
    petal = PeonyPetal(a_x=14.25)
    assert jax.tree.leaves(petal) == [getattr(petal, name) for name in parameters(petal)]
    assert petal.a_x == 14.25  # whatever the precision of jax
    with pytest.raises(dataclasses.FrozenInstanceError):
        petal.a_x = 3.0
