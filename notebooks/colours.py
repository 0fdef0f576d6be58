# %% [markdown]
# # Colours
#
# **Claim.** A fit recovers the paper's patterns of colour, Eqs. 9 and 10, from a picture of a petal and
# from a cloud with colours. It also recovers the two colours that a pattern mixes.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np
import pictures

import petalfit as pf
from petalfit.colours import to_srgb
from petalfit.surfaces import sample_uv
from petalfit.surfaces.programs import position_and_normal

ground, ring = "#eed3dd", "#a8326c"
truth = pf.RadialPattern(i_1=0.05, i_2=0.9, n=5.0, f=0.9, phi=0.2)
painted = pf.Colour.of(ground, ring, patterns=(truth,))
rng = np.random.default_rng(2)
image = painted.texture((128, 128)) / 255 + 0.02 * rng.standard_normal((128, 128, 3))
image = np.clip(image, 0.0, 1.0)

# %% [markdown]
# ## From a texture
#
# The texture is a noisy picture of the flattened petal, with u to the right and the tip at the top.
# Colours mix in linear light. The fit finds the line between two colours, and the pattern along it.
# Uniform noise of the picture is not uniform in linear light. The standard errors do not account for
# that, so errors as large as three standard errors occur here.

# %%
result = pf.fit(pf.RadialPattern, pf.Texture(image), palette=(ground, ring))
fitted = pf.Colour(result.palette, (result.model,))
names = result.names
pictures.table(
    ["", "truth", "found", "±"],
    [(f"`{n}`", float(getattr(truth, n)), result.values[n], result.stderr[n]) for n in names],
)

# %%
for name in names:
    assert result.identifiable[name]
    # Mixed in linear light, the noise is not quite Gaussian.
    assert abs(result.values[name] - getattr(truth, name)) < max(5 * result.stderr[name], 0.03)

petal = pf.PeonyPetal(rib_amplitude=0.1, midrib_height=0.5)
figure, boxes = plt.subplots(1, 4, figsize=(9.6, 3.0))
for box, picture, title in (
    (boxes[0], image, "the picture"),
    (boxes[1], fitted.texture((128, 128)), "the pattern found"),
):
    box.imshow(picture, extent=(-0.5, 0.5, 0, 1), aspect=1.3)
    box.set(title=title, xlabel="u", ylabel="v")
for box, colour, title in ((boxes[2], painted, "made"), (boxes[3], fitted, "found")):
    pictures.picture(box, [pictures.sheet(petal, colour, resolution=(129, 97))])
    box.set_title(title)
figure.tight_layout()

# %% [markdown]
# ## From a cloud
#
# A scan with red, green and blue gives the position and the colour of each point. The shape is fitted
# first. The foot points on it are the (u, v) of the colours.

# %%
ribs = pf.RibPattern(i_1=0.5, i_2=0.45, f=9.0, n_1=0.5, n_2=0.6, k=0.4)
veined = pf.Colour.of("#fff3d6", "#c8702a", patterns=(ribs,))
shape = pf.PeonyPetal(a_x=16.0, b_y=25.0, c=0.5, dx=0.5, dy=4.0, rib_frequency=15.0)
with jax.enable_x64(True):
    u, v = sample_uv(shape, 1500, rng).T  # uniform by area
    points, _ = position_and_normal(shape, u, v)
    points = np.asarray(points) + 0.05 * rng.standard_normal((1500, 3))
    colours = np.asarray(to_srgb(veined(u, v))) + 0.02 * rng.standard_normal((1500, 3))
cloud = pf.PointCloud(points, colours=np.clip(colours, 0, 1))

petal = pf.fit_petal(cloud)
found = pf.fit(pf.RibPattern, cloud, surface=petal, palette=("#fff3d6", "#c8702a"))
pictures.table(
    ["", "truth", "found", "±"],
    [(f"`{n}`", float(getattr(ribs, n)), found.values[n], found.stderr[n]) for n in found.names],
)

# %%
assert abs(found.values["f"] - ribs.f) < 0.1
assert abs(found.values["i_2"] - ribs.i_2) < 0.05

figure, (left, middle, right) = plt.subplots(1, 3, figsize=(9.0, 3.6))
pictures.dots(left, points, c=cloud.colours, s=7)
left.set_title("a coloured cloud")
pictures.picture(middle, [pictures.sheet(petal.model, resolution=(161, 97))], size=420)
middle.set_title("its shape")
fitted = pf.Colour(found.palette, (found.model,))
pictures.picture(right, [pictures.sheet(petal.model, fitted, resolution=(161, 97))], size=420)
right.set_title("and its colours")
figure.tight_layout()
