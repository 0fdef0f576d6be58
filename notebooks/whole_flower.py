# %% [markdown]
# # A whole flower from one scan
#
# **Claim.** From points alone, without a word about what they are, one gets the petals of a flower: how
# many there are, which point belongs to which, the numbers of each, and how they stand about the axis.
# The flower that is found can be edited and grown again.
#
# Nine petals stand along a golden spiral. The outer ones are wide open, and every petal has a length and
# a width of its own; its curl and its ribs are the same for all.

# %%
import dataclasses

import jax
import matplotlib.pyplot as plt
import numpy as np
import pictures
import trimesh
from scipy.spatial import KDTree

import petalfit as pf
from petalfit.report.portrait import flower_sheets

COUNT, NOISE = 9, 0.05
rng = np.random.default_rng(4)
places = pf.recursion(COUNT, growth=0.985)
shared = {"tip_curl": 1.4, "rib_frequency": 18.0}
petals = [
    pf.PeonyPetal(
        a_x=13 + 2 * rank + 0.5 * rng.normal(),
        b_y=14 + 4 * rank + 0.5 * rng.normal(),
        c=0.6,
        dx=0.35,
        dy=2 + 2 * rank + 0.2 * rng.normal(),
        rib_amplitude=0.35,
        midrib_height=0.6,
        **shared,
    )
    for rank in places.rank
]
green = {"receptacle": pf.Colour.of("#7f9a4a"), "pedicel": pf.Colour.of("#55803a")}
series = pf.Series.of(
    "petal",
    petals,
    places,
    pictures.PINK,
    latitude=-0.3 + 0.3 * places.rank,
    opening=1.3 - 0.6 * places.rank + 0.03 * rng.normal(size=COUNT),
)
flower = pf.Flower("nine", pf.Bowl(r=2.4), None, (series,), green)

# %% [markdown]
# ## The scan
#
# Its points lie on the petals, evenly, with noise, turned and moved. No label goes with them.

# %%
(part,) = (part for part in flower.parts() if part.series == 0)
meshes = []
for k in range(COUNT):
    surface, inner, outer = jax.tree.map(
        lambda leaf, k=k: leaf[k], (part.surface, part.inner, part.outer)
    )
    mesh = surface.mesh((161, 81)).copy()
    mesh.vertices = np.asarray((outer @ inner)(np.asarray(mesh.vertices)))
    meshes.append(mesh)
every = trimesh.util.concatenate(meshes)
points, face = trimesh.sample.sample_surface(every, 6000, seed=1)
truth = face // len(meshes[0].faces)
turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
turn = turn * np.sign(np.linalg.det(turn))
cloud = (points + NOISE * rng.normal(size=points.shape)) @ turn.T + [120.0, -7.0, 44.0]

# %% [markdown]
# ## The petals
#
# `model` names the petals' class; by default it is a `BladePetal`, which follows petals of any origin.
# `shared` names what all petals have in common.

# %%
found = pf.fit_flower(cloud, model=pf.PeonyPetal, shared=tuple(shared))
names = [np.bincount(truth[found.labels == k]).argmax() for k in range(found.count)]
right = np.append(names, -1)[found.labels] == truth

colours = plt.get_cmap("tab10")(found.labels % 10)
seen = found.axis.into(cloud)
figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.6))
pictures.dots(axes[0], seen, c="#9a9aa0", s=2)
axes[0].set_title("the scan")
pictures.dots(axes[1], seen, c=colours, s=2)
axes[1].set_title(f"{found.count} petals, {100 * right.mean():.1f} % of the points right")
plt.show()

# %%
opening = np.degrees(np.asarray(found.flower().series[0].attachment.opening))
true_opening = np.degrees(np.asarray(series.attachment.opening))[names]
pictures.table(
    ["petal", "a_x", "true", "b_y", "true", "opening [°]", "true"],
    [
        [
            name,
            f"{petal.values['a_x']:.2f} ± {petal.stderr['a_x']:.2f}",
            f"{petals[k].a_x:.2f}",
            f"{petal.values['b_y']:.2f} ± {petal.stderr['b_y']:.2f}",
            f"{petals[k].b_y:.2f}",
            f"{angle:.1f}",
            f"{true:.1f}",
        ]
        for name, petal, k, angle, true in zip(
            found.names, found.petals, names, opening, true_opening, strict=True
        )
    ],
)

# %% [markdown]
# What all share has an error of its own, which several petals make small:

# %%
pictures.table(
    ["shared", "found", "true"],
    [[name, str(found.shared[name]), value] for name, value in shared.items()],
)

# %%
assert found.count == COUNT
assert sorted(names) == list(range(COUNT))
assert right.mean() > 0.97
assert np.abs(opening - true_opening).max() < 4 * np.degrees(found.layout.axis_stderr) < 5
assert abs(np.degrees(found.layout.divergence.value) - 137.5) < 1
for name, value in shared.items():
    assert abs(found.shared[name].value - value) < 4 * found.shared[name].stderr
found.layout.described

# %% [markdown]
# ## The flower grows again
#
# `FlowerResult.flower()` is a `Flower` like any other. Here it is as it was scanned, and with its petals
# opened by 20° more.

# %%
again = found.flower()
attachment = again.series[0].attachment
wider = dataclasses.replace(attachment, opening=attachment.opening + np.radians(20))
opened = dataclasses.replace(
    again, series=(dataclasses.replace(again.series[0], attachment=wider),)
)
pictures.panels(
    [
        ("the flower that was scanned", flower_sheets(flower)),
        ("grown from the scan", flower_sheets(again)),
        ("opened by 20°", flower_sheets(opened)),
    ],
    3,
)

# %%
grown = found.axis(np.asarray(again.points((129, 129)), float))
away = np.asarray(KDTree(grown).query(cloud)[0])
diagonal = float(np.linalg.norm(np.ptp(cloud, axis=0)))
assert np.quantile(away, 0.99) < 0.01 * diagonal
f"99 % of the points lie within {100 * np.quantile(away, 0.99) / diagonal:.2f} % of the diagonal"
