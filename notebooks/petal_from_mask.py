# %% [markdown]
# # A petal from one mask, and what the mask does not determine
#
# **Claim.** One binary mask from an oblique view determines the outline and the bend of a petal to
# within a percent or two. It does not determine the ribs, and the result reports that. A mask from the
# front determines only the outline.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pictures

import petalfit as pf
from petalfit.surfaces import outline_rings

truth = pf.PeonyPetal(a_x=15.0, b_y=24.0, c=0.55, dx=0.5, dy=5.0, tip_curl=1.5)


def camera_from(direction):
    """An image of 256 × 256 pixels that the petal nearly fills."""
    points = np.asarray(truth.mesh((33, 33)).vertices)
    middle = points.mean(axis=0)

    def look(scale):
        eye = middle + direction
        return pf.Camera.look_at(eye, middle, (256, 256), pixels_per_unit=scale)

    return look(205 / np.ptp(look(1.0).project(points), axis=0).max())


cameras = {
    "aslant": camera_from((0.6, -0.9, 1.1)),
    "front": camera_from((0.0, 0.0, 1.0)),
    "tip": camera_from((0.0, 1.0, 0.05)),
}
results = {
    view: pf.fit_petal(truth.silhouette(camera).mask >= 0.5, camera=camera)
    for view, camera in cameras.items()
}

# %% [markdown]
# The pictures show the masks and the outlines of the fitted petals. All three fit to a fraction of a
# pixel, so the quality of the fit does not show which parameters can be trusted.

# %%
figure, axes = plt.subplots(1, 4, figsize=(10.0, 3.0))
for box, (view, result) in zip(axes, results.items(), strict=False):
    (part,) = result.agreements
    box.imshow(np.where(part.target.mask[..., None] > 0, (0.55, 0.55, 0.58, 0.55), (0, 0, 0, 0)))
    for ring in outline_rings(result.model, cameras[view]):
        box.plot(*np.vstack([ring, ring[:1]]).T, color=pictures.ROSE, linewidth=1.3)
    box.set_axis_off()
    box.set_title(f"{view}: {part.noise:.2f} px")
pictures.picture(axes[3], [pictures.sheet(results["aslant"].model, resolution=(161, 97))], size=420)
axes[3].set_title("the petal of the mask aslant")
figure.tight_layout()

# %% [markdown]
# ## What each view determines
#
# A parameter is called *not determined* if its standard error is not clearly smaller than its typical
# range.


# %%
def told(result, name):
    if not result.identifiable[name]:
        return "*not determined*"
    return f"{result.values[name]:.3f} ± {result.stderr[name]:.3f}"


names = results["aslant"].names
pictures.table(
    ["parameter", "truth", *results],
    [(f"`{n}`", float(getattr(truth, n)), *(told(r, n) for r in results.values())) for n in names],
)

# %%
aslant, front, tip = results.values()
assert {n for n in names if front.identifiable[n]} == {"a_x", "b_y", "c"}
assert not aslant.identifiable["rib_frequency"]
assert not aslant.identifiable["rib_amplitude"]
for name in ("a_x", "b_y", "c", "dx", "dy"):
    assert aslant.identifiable[name]
    assert abs(aslant.values[name] - getattr(truth, name)) < 4 * aslant.stderr[name] + 1e-3
assert abs(aslant.values["a_x"] / truth.a_x - 1) < 0.01
assert any("rib_frequency is not determined" in words for words in aslant.warnings)

# %% [markdown]
# ## Rivals
#
# The curvature at one minimum does not show other minima, and the rib frequency has many. The result
# therefore keeps the minimum that each start reached. By chance alone the best of about two hundred
# frequencies leads by ten in χ². The frequency is called determined only if every rival, and the petal
# without ribs, is worse by twenty. Seen from the tip the ribs are waves of the outline, and there the
# frequency is determined:

# %%
starts = sorted(tip.starts, key=lambda start: start.delta_chi2)
assert tip.identifiable["rib_frequency"]
assert abs(tip.values["rib_frequency"] / truth.rib_frequency - 1) < 0.02
assert starts[1].delta_chi2 > 20
pictures.table(
    ["start", "Δχ²", "`rib_frequency`", "`rib_amplitude`"],
    [
        (s.label, f"{s.delta_chi2:.1f}", s.values["rib_frequency"], s.values["rib_amplitude"])
        for s in starts
    ],
)

# %% [markdown]
# ## A profile
#
# A profile shows more than a standard error. It holds one parameter at several values and fits the
# others again at each. The curve is Δχ² against `dx`. The 95 % interval is where the curve lies below
# the line.

# %%
profile = aslant.with_profile("dx", points=7).profiles["dx"]
low, high = profile.interval(0.95)
figure, box = plt.subplots(figsize=(5.2, 2.8))
box.plot(profile.values, profile.delta_chi2, "o-", color=pictures.BLUE, markersize=4)
box.axhline(3.84, color=pictures.GREY, linewidth=0.8)
box.axvline(truth.dx, color=pictures.ROSE, linewidth=1.2, label="truth")
box.axvspan(low, high, color=pictures.BLUE, alpha=0.12)
box.set(xlabel="dx", ylabel="Δχ²", ylim=(0, 30))
box.legend()
assert low < aslant.values["dx"] < high
assert high - low < 0.5  # of a typical range of several
