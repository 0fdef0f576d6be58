# %% [markdown]
# # Noise, clutter and the Cramér–Rao bound
#
# **Claim.** The errors of a fit are as small as the points allow, and its standard errors have the
# right size. If there is clutter among the points, a robust fit still finds the petal, and reports
# which points it used.

# %%
import dataclasses

import jax
import matplotlib.pyplot as plt
import numpy as np
import pictures

import petalfit as pf
from petalfit.surfaces import sample_uv
from petalfit.surfaces.programs import position_and_normal

truth = pf.PeonyPetal(a_x=16.0, b_y=25.0, c=0.5, dx=0.5, dy=4.0, rib_frequency=15.0)
NAMES = tuple(name for name, p in pf.parameters(truth).items() if not p.fixed)
TRUE = np.array([float(getattr(truth, name)) for name in NAMES])

# %% [markdown]
# ## The bound
#
# If a point has noise σ in all directions, its information about the surface is that of its normal
# distance, whose derivative is n · ∂S/∂θ. The Fisher information is the sum of the outer products of
# these derivatives over all points, divided by σ². No unbiased estimate from normal distances has
# smaller standard errors than the square root of the diagonal of its inverse. This bound needs the
# truth, so it cannot serve as an error bar. It is the reference that error bars are compared with.


# %%
def cramer_rao(n, noise, seed=0):
    """The least standard errors from n points inside the petal."""

    def position(values, u, v):
        return dataclasses.replace(truth, **dict(zip(NAMES, values, strict=True)))(u, v)

    with jax.enable_x64(True):
        u, v = sample_uv(truth, n, np.random.default_rng(seed)).T
        slopes = jax.jit(jax.jacfwd(position))(TRUE, u, v)
        _, normals = position_and_normal(truth, u, v)
    rows = np.einsum("nxp,nx->np", slopes, normals) / noise
    return np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))


levels = (0.02, 0.05, 0.1, 0.2)
fits = {
    noise: [pf.fit_petal(truth.sample(1500, seed=seed, noise=noise)) for seed in range(4)]
    for noise in levels
}

# %%
bound = cramer_rao(1500, 1.0)
error = np.array(
    [
        [[fit.values[n] - x for n, x in zip(NAMES, TRUE, strict=True)] for fit in group]
        for group in fits.values()
    ]
)
stderr = np.array([[[fit.stderr[n] for n in NAMES] for fit in group] for group in fits.values()])
scale = np.array(levels)[:, None, None] * bound

figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.5), width_ratios=(1.25, 1))
for k, name in enumerate(NAMES):
    colour = plt.cm.twilight(0.1 + 0.8 * k / len(NAMES))
    rms = np.sqrt(np.mean(error[..., k] ** 2, axis=1))
    left.loglog(levels, rms / bound[k], "o", color=colour, markersize=4, label=name)
left.loglog(levels, levels, color=pictures.GREY, linewidth=1)
left.set(xlabel="noise σ", ylabel="rms error / bound at σ = 1", title="errors grow like the bound")
left.legend(ncols=2, fontsize=7)
right.hist((error / stderr).ravel(), bins=np.linspace(-4, 4, 25), density=True, color=pictures.BLUE)
z = np.linspace(-4, 4, 200)
right.plot(z, np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi), color=pictures.ROSE)
right.set(xlabel="error / reported standard error", yticks=[], title="and error bars are right")
figure.tight_layout()

# %% [markdown]
# Some errors are below the bound. The bound uses only the normal distances, but the fit also uses the
# position of the edge, which helps `a_x`, `b_y` and `c`.

# %%
ratio = np.sqrt(np.mean((error / scale) ** 2))
assert 0.4 < ratio < 1.3
assert np.all(stderr < 1.25 * scale)
covered = np.mean(np.abs(error) < 1.96 * stderr)
assert covered > 0.88  # of 160 intervals, where 95 % are wanted
pictures.table(
    ["", ""],
    [
        ["rms error over the bound", float(ratio)],
        ["95 % intervals that hold the truth", f"{100 * covered:.0f} %"],
    ],
)

# %% [markdown]
# ## Too much noise
#
# Ribs of height 0.3 cannot be seen under noise of 1. The fit reports them as not determined. With that
# much noise it may not converge. It reports that, too, and its errors allow for the way that was left.

# %%
drowned = pf.fit_petal(truth.sample(1500, seed=1, noise=1.0), throw=False)
assert not drowned.identifiable["rib_frequency"]
assert not drowned.identifiable["rib_amplitude"]
drowned.message

# %% [markdown]
# ## Clutter
#
# A third of these points are clutter. Least squares fits all points. `loss="robust"` weights every
# point by the probability that it belongs to the surface.

# %%
rng = np.random.default_rng(0)
petal = truth.sample(1000, seed=5, noise=0.05).points
low, high = petal.min(axis=0) - 3, petal.max(axis=0) + 3
points = np.vstack([petal, rng.uniform(low, high, (500, 3))])
clutter = np.arange(len(points)) >= len(petal)
linear = pf.fit_petal(points, throw=False)
robust = pf.fit_petal(points, loss="robust")
(part,) = robust.agreements

figure, (left, right) = plt.subplots(1, 2, figsize=(8.4, 4.0))
pictures.dots(left, points, c=pictures.GREY, s=4)
left.set_title("1,000 points of a petal, 500 of nothing")
pictures.dots(right, points[~part.used], c=pictures.ROSE, s=4, alpha=0.35)
pictures.dots(right, points[part.used], c=pictures.BLUE, s=4)
right.set_title(f"{part.used.sum()} points that the fit believed")
figure.tight_layout()

# %%
kept, refused = np.mean(part.used[~clutter]), np.mean(~part.used[clutter])
assert kept > 0.97
assert refused > 0.9
assert abs(robust.values["a_x"] / truth.a_x - 1) < 0.01
assert abs(robust.values["b_y"] / truth.b_y - 1) < 0.01
pictures.table(
    ["", "truth", "least squares", "robust"],
    [
        (f"`{name}`", float(getattr(truth, name)), linear.values[name], robust.values[name])
        for name in ("a_x", "b_y", "c", "dx", "dy", "rib_frequency")
    ],
)
