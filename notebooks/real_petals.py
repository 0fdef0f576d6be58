# %% [markdown]
# # Petals that no equation made
#
# **Claim.** A `BladePetal` follows a petal that no family describes exactly to within one percent of
# its size, in any position and unit. The comparison shows which family explains the petal best, and the
# result shows where the model does not follow it.
#
# petalfit comes with no scans, so the petal below is made, but not by any of the models. It has a
# lopsided outline with a notch, a midrib on a spiral, a margin that ruffles more and more towards the
# tip, a dent, and a random smooth relief. The points have an arbitrary pose and another unit.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pictures
from scipy.ndimage import gaussian_filter

import petalfit as pf


def odd_petal(n, seed=0):
    """Points (n, 3) of a surface that is in no family."""
    rng = np.random.default_rng(seed)
    t, s = rng.uniform(-1, 1, 6 * n), rng.uniform(0, 1, 6 * n)
    half = 0.13 + 0.87 * np.sin(np.pi * s**1.1 / 1.12) ** 1.1  # half width along the petal
    keep = rng.uniform(size=6 * n) < half / half.max()
    t, s, half = t[keep][:n], s[keep][:n], half[keep][:n]
    across = 9 * half * (t + 0.12 * (1 - t**2) * np.sin(3 * s))
    along = 27 * (s + 0.07 * s**4 * (np.abs(t) ** 1.5 - 0.6 * t - 0.9))
    turn = 0.15 * along / 27 + 0.6 * (along / 27) ** 3  # the midrib winds up
    relief = gaussian_filter(rng.standard_normal((64, 64)), 9)
    relief = 0.45 * relief / np.abs(relief).max()
    i, j = ((t + 1) * 31.4).astype(int), (s * 62.9).astype(int)
    lift = (
        0.035 * across**2
        + 0.5 * t**4 * s**2 * np.sin(15 * s + 2 * np.tanh(9 * t))
        - 1.1 * np.exp(-((t - 0.3) ** 2 + (2.2 * (s - 0.55)) ** 2) / 0.06)
        + relief[i, j]
    )
    y = along * np.cos(turn / 2) - lift * np.sin(turn)
    z = along * np.sin(turn / 2) + lift * np.cos(turn)
    return np.stack([across, y, z], axis=-1)


rng = np.random.default_rng(4)
R_scan_petal = np.linalg.qr(rng.standard_normal((3, 3)))[0]
R_scan_petal *= np.linalg.det(R_scan_petal)
scan = odd_petal(768) + 0.04 * rng.standard_normal((768, 3))
scan = 3.1 * scan @ R_scan_petal.T + [120.0, -40.0, 15.0]
size = float(np.linalg.norm(np.ptp(scan, axis=0)))

# %% [markdown]
# ## Three families
#
# `model="auto"` fits all families and ranks them by Schwarz's criterion (BIC): minus twice the log
# likelihood, plus a penalty for the number of parameters. A difference of ten is a strong preference.

# %%
best = pf.fit_petal(scan, model="auto", pose="similarity", throw=False)
pictures.table(
    ["family", "ΔBIC", "rms / size", "numbers"],
    [
        (
            rank.model,
            f"{rank.delta_bic:.0f}",
            f"{100 * rank.rms / size:.2f} %",
            f"{rank.freedom:.0f}",
        )
        for rank in best.ranking
    ],
)

# %%
order = [rank.model for rank in best.ranking]
assert order[0] == "SplinePetal"
assert order.index("BladePetal") == 1
assert best.ranking[1].delta_bic > 10
rms = {rank.model: rank.rms / size for rank in best.ranking}
assert rms["SplinePetal"] < 0.004
assert rms["BladePetal"] < 0.01

# %% [markdown]
# The splines come closest, but they have no named parameters. The parameters of the blade can be read,
# compared and edited, so the blade is the better choice for reporting a hundred petals.

# %%
blade = pf.fit_petal(scan, model=pf.BladePetal, pose="similarity", throw=False)
centre = scan.mean(axis=0)
axes_of = np.linalg.eigh(np.cov((scan - centre).T))[1][:, [1, 2, 0]]
axes_of *= np.sign(np.linalg.det(axes_of))
figure, boxes = plt.subplots(1, 4, figsize=(10.0, 3.4))
pictures.dots(boxes[0], (scan - centre) @ axes_of, s=4)
boxes[0].set_title("the scan")
for box, result, name in ((boxes[1], blade, "BladePetal"), (boxes[2], best, order[0])):
    grid = (np.asarray(result.mesh((19, 25)).vertices) - centre) @ axes_of
    seen = pictures.looked_at(grid)[0].reshape(19, 25, 2)
    for line in (*seen, *seen.swapaxes(0, 1)):
        box.plot(*line.T, color=pictures.ROSE, linewidth=0.6)
    box.set_aspect("equal")
    box.set_axis_off()
    box.set_title(name)
(part,) = blade.agreements
limit = 3 * blade.rms
drawn = boxes[3].scatter(
    *part.uv.T, c=part.distances, s=7, cmap=pictures.SIGNED, vmin=-limit, vmax=limit
)
boxes[3].set(title="distance to the blade", xlabel="u", ylabel="v")
figure.colorbar(drawn, ax=boxes[3])
figure.tight_layout()

# %% [markdown]
# ## The quantities of a botanist
#
# With a similarity pose the fit holds the length of a blade and determines the scale. Angles and ratios
# are those of the scan. The residuals are not noise, as the map shows: in patches of one colour the
# scan has a shape that the blade cannot take. The result has a warning, and its standard errors allow for
# the misfit (`stderr_noise` has those of noise alone).

# %%
shown = ("width", "widest", "tip_width", "skew", "bend", "tip_roll", "cup_base", "cup_mid", "twist")
pictures.table(
    ["", "", "±"],
    [
        (
            f"`{name}`",
            blade.values[name],
            f"{blade.stderr[name]:.2g}" if blade.identifiable.get(name) else "*not determined*",
        )
        for name in shown
    ],
)

# %%
print("\n".join(blade.warnings))
assert any("systematic" in words for words in blade.warnings)
assert blade.misfit is not None
assert all(blade.stderr[name] > blade.stderr_noise[name] for name in ("width", "bend"))

# %% [markdown]
# ## Rotated, scaled and shuffled
#
# The result does not depend on the pose, the unit or the order of the points.

# %%
other = np.linalg.qr(np.random.default_rng(9).standard_normal((3, 3)))[0]
other *= np.linalg.det(other)
again = pf.fit_petal(
    0.2 * scan[::-1] @ other.T - 7.0, model=pf.BladePetal, pose="similarity", throw=False
)
for name in ("width", "widest", "bend"):
    assert abs(again.values[name] - blade.values[name]) < 0.01
assert abs(again.rms / (0.2 * blade.rms) - 1) < 0.01
