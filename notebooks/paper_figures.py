# %% [markdown]
# # The paper's figures
#
# **Claim.** The equations of the paper, as printed, reproduce its figures, with one exception: the last
# step of Eq. 4.
#
# [The gallery](../docs/gallery.md) has a picture for every figure, and [the paper, equation by
# equation](../docs/paper.md) lists where petalfit differs from the printed equations.

# %%
import jax.numpy as jnp
import numpy as np
import pictures
from pictures import LEAF, sheet

import petalfit as pf
from petalfit.report.portrait import flower_sheets

# %% [markdown]
# ## Fig. 2: from a cylinder to a pedicel
#
# Eq. 2 swells a cylinder along its normal and bends it. In plain numpy this takes four lines. The
# component agrees with them to 1e-12.

# %%
pedicel = pf.Pedicel(r=4.0, h=30.0, a_1=3.0, a_2=3.0)
u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, 1, 25), indexing="ij")
swollen = 4.0 + 3.0 * np.sin(np.pi * v - 1)
bend = 3.0 * np.sin(np.pi * v)
printed = np.stack([swollen * np.cos(u) + bend, 30 * v, swollen * np.sin(u) + bend], axis=-1)
assert np.allclose(sheet(pedicel, resolution=(49, 25)).vertices, printed, atol=1e-12)


class Uneven(pf.Pedicel):
    """A pedicel before it is bent."""

    def offset(self, u, v):
        return jnp.zeros((*u.shape, 3))


pictures.panels(
    [
        ("cylinder (Eq. 1)", [sheet(pf.Cylinder(4.0, 30.0), LEAF)]),
        ("uneven, a_1 = 3", [sheet(Uneven(a_1=3.0), LEAF)]),
        ("and bent, a_2 = 3 (Eq. 2)", [sheet(pedicel, LEAF)]),
    ],
    3,
    elevation=0.2,
)

# %% [markdown]
# ## Fig. 4: from an ellipsoid to a bowl
#
# Here the printed equation and the figure disagree. The printed last step adds −r cos(π/2 − u) to *z*.
# This shears the upper half sideways and does not hollow it. Fig. 4(c) shows a bowl, which results from
# adding a multiple of the term to *y*. `hollow="printed"` selects the printed step.

# %%
bowl, sheared = pf.Bowl(), pf.Bowl(hollow="printed")
inside, above = (sheet(surface).vertices[-1, 0, 1] for surface in (bowl, sheared))
assert inside < 0 < above  # the top, u = π/2: turned down into the bowl, or still on top
pictures.panels(
    [
        ("(a) ellipsoid", [sheet(pf.Ellipsoid(2.0, 6.0, 2.0), LEAF)]),
        ("(c) bowl", [sheet(bowl, LEAF)]),
        ("(c) cut open", [sheet(bowl, LEAF, half=True)]),
        ("as printed", [sheet(sheared, LEAF)]),
    ],
    4,
    azimuth=0.9,
)

# %% [markdown]
# ## Fig. 6: from a rectangle to a peony petal
#
# The pictures add the terms of Eq. 8 one after the other.

# %%
petal = pf.PeonyPetal(rib_amplitude=0.5)
bare = dict(dx=0.0, dy=0.0, rib_amplitude=0.0, midrib_height=0.0, tip_curl=0.0)
steps = [
    ("rectangle", pf.Rectangle(petal.a_x, petal.b_y)),
    ("outline, Δx and Δy", pf.PeonyPetal(**bare)),
    ("bend, dy", pf.PeonyPetal(**bare | {"dy": 3.0})),
    ("ribs", pf.PeonyPetal(**bare | {"dy": 3.0, "rib_amplitude": 0.5})),
    ("midrib, waves, curl", petal),
]
flat = np.asarray(steps[1][1].mesh().vertices)
assert np.allclose(flat[:, 2], 0)  # an outline has no height
pictures.panels(
    [(title, [sheet(surface, resolution=(161, 81))]) for title, surface in steps],
    5,
    azimuth=0.35,
    elevation=0.25,
    width=2.0,
)

# %% [markdown]
# ## Figs. 8 and 9: a peony
#
# The paper says: "The inside petals are bigger and more bender than outside petals."

# %%
peony = pf.peony()
petals = peony.series[0].organ
for name in ("a_x", "b_y", "dy"):
    outside, inside = np.asarray(getattr(petals, name)).reshape(2, -1).mean(axis=1)
    assert inside > outside, name
pictures.panels(
    [("", flower_sheets(peony)), ("", flower_sheets(pf.lily()))], 2, 520, elevation=0.6, width=4.4
)
