# %% [markdown]
# # A petal from a cloud
#
# **Claim.** A fit recovers all ten free parameters of a peony petal from fifteen hundred noisy points,
# and its standard errors show how accurate they are.
#
# The petal is made by the paper's Eqs. 7 and 8, so the truth is known. The fit gets only the points: no
# start, no noise level and no number of ribs.

# %%
import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pictures

import petalfit as pf

truth = pf.PeonyPetal(
    a_x=16.0, b_y=25.0, c=0.5, dx=0.5, dy=4.0, rib_frequency=15.0, rib_amplitude=0.5, tip_curl=1.6
)
cloud = truth.sample(1500, seed=3, noise=0.05)
result = pf.fit_petal(cloud.points)
result.message

# %% [markdown]
# ## Every parameter with its error
#
# The last column is the true error in units of the reported standard error. About two out of three
# should be below one, and nearly all below two.

# %%
rows = []
for name in result.names:
    true, found, error = getattr(truth, name), result.values[name], result.stderr[name]
    rows.append((f"`{name}`", float(true), found, error, f"{(found - true) / error:+.1f}"))
pictures.table(["parameter", "truth", "found", "standard error", "off by"], rows)

# %%
off = np.array([(result.values[n] - getattr(truth, n)) / result.stderr[n] for n in result.names])
assert result.converged
assert not result.warnings
assert np.all(np.abs(off) < 4)
assert abs(result.rms / 0.05 - 1) < 0.06  # what is left is the noise
inside = [low < getattr(truth, n) < high for n, (low, high) in result.interval(0.95).items()]
assert sum(inside) >= 9

# %% [markdown]
# ## The points, the petal and the residuals
#
# The right picture shows the signed distance of every point at its foot point on the petal, with u
# across and v along. A model that cannot follow its target would show patches of one colour. There are
# none here, so the distances are noise.

# %%
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(9.6, 3.7), width_ratios=(1, 1, 1.05))
pictures.dots(left, cloud.points, s=2)
left.set_title(f"{len(cloud)} points")
pictures.picture(middle, [pictures.sheet(result.model, resolution=(161, 97))], size=480)
middle.set_title("the petal that explains them")
(part,) = result.agreements
drawn = right.scatter(
    *part.uv.T, c=part.distances, s=5, cmap=pictures.SIGNED, vmin=-0.15, vmax=0.15
)
right.set(xlabel="u", ylabel="v", title=f"signed distance, rms {result.rms:.3f}")
figure.colorbar(drawn, ax=right, shrink=0.8)
figure.tight_layout()

# %% [markdown]
# ## Parameters can be edited
#
# A point cloud cannot be changed to have deeper ribs. A petal with parameters can.

# %%
found = result.model
edits = {
    "as found": {},
    "deeper ribs": {"rib_amplitude": 1.2},
    "more ribs": {"rib_frequency": 31.0},
    "arched": {"dy": 11.0},
    "curled": {"tip_curl": 4.0},
}
pictures.panels(
    [
        (title, [pictures.sheet(dataclasses.replace(found, **edit), resolution=(161, 81))])
        for title, edit in edits.items()
    ],
    5,
    width=1.95,
)
