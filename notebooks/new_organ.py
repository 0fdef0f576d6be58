# %% [markdown]
# # A new organ in ten lines
#
# **Claim.** Any surface that maps (u, v) to space can be fitted. An organ that the paper does not have
# takes ten lines, and is recovered from a cloud without a start, with standard errors and warnings.
#
# The example is a strap-shaped ray floret. It narrows to both ends, is folded along its middle and
# bends outwards:

# %%
import tempfile
from pathlib import Path
from typing import ClassVar

import jax.numpy as jnp
import matplotlib.pyplot as plt
import pictures

import petalfit as pf
from petalfit.report.portrait import flower_sheets
from petalfit.surfaces import AbstractSurface, Domain, Scalar, angle, length


class RayFloret(AbstractSurface):
    width: Scalar = length(6.0, "w", (0.5, 40.0), (3.0, 10.0), "greatest width")
    reach: Scalar = length(24.0, "l", (2.0, 150.0), (12.0, 36.0), "length along the midrib")
    bend: Scalar = angle(0.5, "β", (-3.0, 3.0), (-1.5, 1.5), "turn from base to tip")
    fold: Scalar = angle(0.4, "φ", (-1.4, 1.4), (0.0, 1.0), "rise of each half from the midrib")
    domain: ClassVar[Domain] = pf.Rectangle.domain
    regular: ClassVar[bool] = True

    def position(self, u, v):
        across = self.width * u * (0.3 + 2.8 * v * (1 - v))
        x, up = across * jnp.cos(self.fold), jnp.abs(across) * jnp.sin(self.fold)
        along = jnp.sinc(self.bend * v / 2 / jnp.pi) * self.reach * v  # a chord of the bent midrib
        y, z = along * jnp.cos(self.bend * v / 2), along * jnp.sin(self.bend * v / 2)
        return jnp.stack([x, y - up * jnp.sin(self.bend * v), z + up * jnp.cos(self.bend * v)], -1)


# %% [markdown]
# Every parameter declares its unit, its bounds and its typical range. The fit searches for starts in
# the typical range, and compares the standard error with it to decide what is *not determined*.
# Normals, area, meshes, samples, silhouettes and derivatives follow from `position`. The organ is
# fitted like every other, to clouds or to masks, and without a start:

# %%
truth = RayFloret(width=7.0, reach=28.0, bend=0.9, fold=0.5)
cloud = truth.sample(1500, seed=1, noise=0.05)
result = pf.fit(RayFloret, cloud)
pictures.table(
    ["", "truth", "found", "±"],
    [
        (f"`{n}`", float(getattr(truth, n)), result.values[n], result.stderr[n])
        for n in result.names
    ],
)

# %%
for name in result.names:
    assert abs(result.values[name] - getattr(truth, name)) < 5 * result.stderr[name]
    assert result.identifiable[name]

figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 3.6))
pictures.dots(left, cloud.points)
left.set_title("the cloud")
yellow = pf.Colour.of("#e8b93f")
pictures.picture(right, [pictures.sheet(result.model, yellow)], size=420)
right.set_title("the floret")
figure.tight_layout()

# %% [markdown]
# `regular` declares that no part of the domain collapses to a point or a line, where the normal would
# need a limit. An organ that is a deformed rectangle, cylinder or ellipsoid in the sense of the paper's
# Eqs. 1, 5 and 7 derives from `AbstractDeformedSurface` instead, and declares its `base`, `offset` and
# `height`. `petalfit/components/sepal.py` is an example.
#
# ## Save and load
#
# A file stores values but no code, so `load` needs the class.

# %%
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder, "floret.json")
    result.save(path)
    again = pf.FitResult.load(path, model=RayFloret)
    try:
        pf.FitResult.load(path)
    except pf.TargetError as error:
        print(str(error).partition(folder)[2].lstrip("/\\"))
    else:
        raise AssertionError("without its class the file means nothing")
assert again.values == result.values

# %% [markdown]
# ## A flower of ray florets
#
# The new organ can be placed in a flower like those of the paper.

# %%
rays = pf.Series.of(
    "ray", result.model, pf.whorls(13, 13), yellow, latitude=0.35, opening=1.15, scale=0.9
)
daisy = pf.Flower(
    name="daisy",
    receptacle=pf.ConeReceptacle(r=7.0, h=5.0),
    pedicel=None,
    series=(rays,),
    colours={"receptacle": pf.Colour.of("#7a4a1c"), "pedicel": pictures.LEAF},
)
assert len(rays) == 26
pictures.panels([("", flower_sheets(daisy))], 1, size=520, elevation=0.95, width=4.6)
