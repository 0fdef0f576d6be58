# %% [markdown]
# # One petal scanned ten times
#
# **Claim.** An error says how far a number may be off, and one can check it: scan the same petal
# again. The numbers of ten scans of a petal that no model follows exactly differ as much as their errors
# say, and not as little as noise alone would let them.
#
# The petal is made of formulas that petalfit does not have: half widths by the superformula of Gielis
# (2003), a section that is a catenary, a margin with ripples, a dent, a notch at the tip and a midrib
# that winds up. As a fine mesh it has a known length, width and area.

# %%
import itertools

import matplotlib.pyplot as plt
import numpy as np
import pictures
import trimesh

import petalfit as pf

NODES = (161, 241)  # across and along
ends, share = np.linspace(-1, 1, NODES[0]), np.linspace(0, 1, NODES[1])
t, s = np.meshgrid(ends, share, indexing="ij")

# Half widths: the superformula in polar coordinates around the base, m = 1, turned into a width at s.
angle = np.linspace(1e-6, np.pi / 2, 2000)
radius = (np.abs(np.cos(angle / 4)) ** 9 + np.abs(np.sin(angle / 4)) ** 11) ** (-1 / 1.7)
radius *= np.cos(angle) ** 0.35
place, half = radius * np.cos(angle), radius * np.sin(angle)
order = np.argsort(place / place.max())
half = np.interp(share, (place / place.max())[order], half[order])
half = 10.5 * half / half.max()

across = half * (t + 0.06 * (1 - t**2) * np.sin(4 * s))
along = 30 * (s - 0.05 * s**6 * (1 - t**2) ** 3)
lift = 14 * (np.cosh(across / 14) - 1)
lift += 0.45 * t**4 * s * np.sin(22 * s + 1)
lift -= 0.8 * np.exp(-(((across - 3) / 3) ** 2) - ((along - 17) / 4) ** 2)
turn = 0.9 * (along / 30) ** 2
step = np.gradient(along, axis=1)
y = np.cumsum(np.cos(turn) * step, axis=1) - lift * np.sin(turn)
z = np.cumsum(np.sin(turn) * step, axis=1) + lift * np.cos(turn)
grid = np.stack([across, y, z], axis=-1)
corners = np.arange(grid[..., 0].size).reshape(NODES)
a, b, c, d = (
    x.ravel() for x in (corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:])
)
mesh = trimesh.Trimesh(
    grid.reshape(-1, 3), np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]), process=False
)


def arc(points):
    """The length of a line through points."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())


TRUE = {
    "length": arc(grid[NODES[0] // 2]),
    "width": max(map(arc, grid.swapaxes(0, 1))),
    "area": mesh.area,
}

# %% [markdown]
# ## Ten scans, ten fits
#
# Each scan has 800 points of its own, with noise of 0.05.

# %%
SCANS = 10


def scan(seed):
    """Points of the petal, as a scanner sees them."""
    points, _ = trimesh.sample.sample_surface(mesh, 800, seed=seed)
    return points + np.random.default_rng(seed).normal(0.0, 0.05, points.shape)


scans = [scan(seed) for seed in range(SCANS)]
blades = [
    pf.fit_petal(x, model=pf.BladePetal, pose="similarity", base=(0, 0, 0), throw=False)
    for x in scans
]
splines = [pf.fit_petal(x, model=pf.SplinePetal, pose="similarity") for x in scans]

# %% [markdown]
# ## What they say
#
# The thick bars are 95 % intervals as reported. They allow for the misfit between the blade and the
# petal, which is a smooth field, estimated from the distances. The thin dark bars are what noise alone
# would claim (`stderr_noise`). Rose lines are the truth, where the mesh has one.

# %%
NAMES = ("width", "widest", "bend", "cup_mid", "cup_tip", "twist")
REACH = 1.96


def measured(fits, name):
    """A trait of all scans and its errors."""
    return np.array([[fit.traits[name].value, fit.traits[name].stderr] for fit in fits]).T


rows = {f"{name} of blades": (measured(blades, name), TRUE[name]) for name in TRUE}
rows["area of splines"] = measured(splines, "area"), TRUE["area"]
for name in NAMES:
    rows[name] = np.array([[fit.values[name], fit.stderr[name]] for fit in blades]).T, None
by_noise = {name: np.array([fit.stderr_noise[name] for fit in blades]) for name in NAMES}

figure, boxes = plt.subplots(2, 5, figsize=(10.0, 4.6), sharex=True)
for box, (name, ((values, errors), true)) in zip(boxes.flat, rows.items(), strict=True):
    bars = {"fmt": "o", "color": pictures.BLUE, "markersize": 3, "linewidth": 3, "alpha": 0.5}
    box.errorbar(range(SCANS), values, REACH * errors, **bars)
    if name in by_noise:
        bars = {"fmt": "none", "color": "#333338", "linewidth": 1}
        box.errorbar(range(SCANS), values, REACH * by_noise[name], **bars)
    if true is not None:
        box.axhline(true, color=pictures.ROSE, linewidth=1)
    box.set_title(name)
    box.set_xticks([])
figure.supxlabel("scan", color=pictures.GREY, fontsize=9)
figure.tight_layout()

# %% [markdown]
# ## Do they agree?
#
# Two of ten scans make 45 pairs. Of 100 pairs, 95 should differ by no more than their intervals allow.


# %%
def agreeing(values, errors):
    """The part of the pairs that agree."""
    pairs = itertools.combinations(range(SCANS), 2)
    return np.mean(
        [abs(values[i] - values[j]) < REACH * np.hypot(errors[i], errors[j]) for i, j in pairs]
    )


def holding(values, errors, true):
    """How many intervals hold the truth."""
    return int(np.sum(np.abs(values - true) < REACH * errors))


shown = []
for name, ((values, errors), true) in rows.items():
    alone = by_noise.get(name)
    shown.append(
        (
            name,
            float(values.mean()),
            f"{values.std(ddof=1):.2g}",
            f"{np.median(errors):.2g}",
            "" if alone is None else f"{np.median(alone):.2g}",
            f"{100 * agreeing(values, errors):.0f} %",
            "" if alone is None else f"{100 * agreeing(values, alone):.0f} %",
            "" if true is None else f"{holding(values, errors, true)} of {SCANS}",
        )
    )
pictures.table(
    ["", "mean", "spread", "error", "by noise", "pairs agree", "by noise", "hold the truth"], shown
)

# %%
agree = [agreeing(*both) for both, _ in rows.values()]
alone = [agreeing(rows[name][0][0], errors) for name, errors in by_noise.items()]
assert np.mean(agree) > 0.93
assert np.mean(alone) < np.mean(agree)
assert holding(*rows["area of blades"][0], TRUE["area"]) >= 8
assert holding(*rows["area of splines"][0], TRUE["area"]) >= 8

# %% [markdown]
# Areas are right, and those of splines have the smaller errors. Some lengths are not: the midrib ends in
# the notch, of which the blade fills a part, so that its midrib is too long in every scan. An error says
# how far a number may be off if the petal is scanned again. A feature that no blade can have is beyond
# it, and is a reason to look at the picture.
