"""Makes the pictures of docs/gallery.md: figures of the paper, and flowers from scans: `make gallery`."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import petalfit as pf
from petalfit.flowers import STAMENS
from petalfit.report.colour import IGNORED, of_petal
from petalfit.report.portrait import Sheet, flower_sheets, portrait
from petalfit.synthetic import FLOWERS, scan

sys.path.append(str(Path(__file__).parents[1] / "notebooks"))
import pictures  # what notebooks draw with
from pictures import sheet

FOLDER = Path(__file__).parent / "gallery"
GREY = "#7a7a80"
GREEN, ROSE, WHITE = pf.Colour.of("#84a94f"), pf.Colour.of("#f0b4c6"), pf.Colour.of("#f4efe6")
Panel = tuple[str, list[Sheet]]


def assembly(organ: pf.AbstractAssembly, colours: dict[str, pf.Colour]) -> list[Sheet]:
    """An organ of several parts."""
    return series(pf.Series.of("organ", organ, pf.whorls(1), colours))


def series(organs: pf.Series) -> list[Sheet]:
    """Organs on a receptacle too small to be seen."""
    nothing = pf.CylinderReceptacle(r=0.06, h=0.06)
    flower = pf.Flower("organs", nothing, None, (organs,), {"receptacle": GREEN, "pedicel": GREEN})
    return flower_sheets(flower)


def draw(name: str, panels: Sequence[Panel], columns: int, **look: float) -> None:
    """Panels in rows, each with its title, as a file."""
    save(pictures.panels(panels, columns, **look), name)


def save(figure: Figure, name: str) -> None:
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{name}.png"
    figure.savefig(path, dpi=130, transparent=True, metadata={"Software": "petalfit"})
    print(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


class Uneven(pf.Pedicel):
    """A pedicel before it is bent."""

    def offset(self, u: jax.Array, v: jax.Array) -> jax.Array:
        return jnp.zeros((*u.shape, 3))


class Swollen(pf.Bowl):
    """A bowl before it is hollowed: Eq. 4."""

    def offset(self, u: jax.Array, v: jax.Array) -> jax.Array:
        return jnp.zeros((*u.shape, 3))


class Outline(pf.PeonyPetal):
    """A petal with its outline and no height."""

    def height(self, u: jax.Array, v: jax.Array, point: jax.Array) -> jax.Array:
        return jnp.zeros_like(u)


class Widened(Outline):
    """A petal with Δx alone."""

    def offset(self, u: jax.Array, v: jax.Array) -> jax.Array:
        return super().offset(u, v) * jnp.array([1.0, 0.0, 0.0])


def figure_1() -> None:
    """The components of a flower, each with its name."""
    lily = pf.lily()
    names = sheet_names(lily)
    # Without the petal in front, which hides the ovary.
    shown = [k for k, name in enumerate(names) if name != "petal_4"]
    names = [names[k] for k in shown]
    sheets = [flower_sheets(lily)[k] for k in shown]
    size = (760, 620)
    picture = portrait(sheets, size, 0.35, 0.35)
    figure = Figure(figsize=(6.2, 6.6))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(picture, interpolation="antialiased")
    # Where each is seen is found by drawing it in a colour of its own.
    wanted = {
        "petal_3": ("petal", (20, 170)),
        "stamen_1/anther": ("anther", (560, 130)),
        "stamen_1/filament": ("filament", (585, 330)),
        "pistil/stigma": ("stigma", (330, 28)),
        "pistil/style": ("style", (430, 90)),
        "pistil/ovary": ("ovary", (120, 400)),
        "receptacle": ("receptacle", (520, 470)),
        "pedicel": ("pedicel", (480, 640)),
    }
    for key, (label, place) in wanted.items():
        marked = [
            s._replace(linear=np.broadcast_to([float(name == key), 0.0, 0.0], s.linear.shape))
            for s, name in zip(sheets, names, strict=True)
        ]
        red = portrait(marked, size, 0.35, 0.35)
        y, x = np.nonzero((red[..., 0] > 60) & (red[..., 3] > 200))
        if not len(x):
            continue
        middle = np.argmin((x - np.median(x)) ** 2 + (y - np.median(y)) ** 2)
        axes.annotate(
            label,
            (x[middle], y[middle]),
            place,
            color=GREY,
            fontsize=11,
            arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.8},
        )
    axes.set_axis_off()
    save(figure, "figure_1")


def sheet_names(flower: pf.Flower) -> list[str]:
    """Of the sheets of a flower, in their order."""
    names = []
    for part in flower.parts():
        if part.series < 0:
            names.append(part.label)
            continue
        for organ in flower.series[part.series].names:
            names.append(f"{organ}/{part.name}" if part.name else organ)
    return names


def figure_2() -> None:
    """A cylinder becomes a pedicel: Eqs. 1 and 2 with a_1 = a_2 = 3."""
    pedicel = pf.Pedicel(a_1=3.0, a_2=3.0)
    draw(
        "figure_2",
        [
            ("cylinder (Eq. 1)", [sheet(pf.Cylinder(pedicel.r, pedicel.h), GREEN)]),
            ("uneven, a_1 = 3", [sheet(Uneven(a_1=3.0), GREEN)]),
            ("and bent, a_2 = 3 (Eq. 2)", [sheet(pedicel, GREEN)]),
        ],
        3,
        elevation=0.2,
    )


def figure_3() -> None:
    """Receptacles."""
    draw(
        "figure_3",
        [
            ("cylinder", [sheet(pf.CylinderReceptacle(), GREEN)]),
            ("cone", [sheet(pf.ConeReceptacle(), GREEN)]),
            ("bowl", [sheet(pf.Bowl(), GREEN)]),
        ],
        3,
    )


def figure_4() -> None:
    """An ellipsoid becomes a bowl: Eqs. 3 and 4, and the last step."""
    draw(
        "figure_4",
        [
            ("(a) ellipsoid (Eq. 3)", [sheet(pf.Ellipsoid(2.0, 6.0, 2.0), GREEN)]),
            ("(b) swollen (Eq. 4)", [sheet(Swollen(), GREEN)]),
            ("(c) the upper part inside", [sheet(pf.Bowl(), GREEN)]),
            ("(c) cut open", [sheet(pf.Bowl(), GREEN, half=True)]),
            ("the last step as printed", [sheet(pf.Bowl(hollow="printed"), GREEN)]),
        ],
        5,
        azimuth=0.9,
    )


def figure_5() -> None:
    """Pistils, and the stamens of 2.3."""
    carpel = pf.Pistil(pf.Ovary(r=2.0), pf.Style(r=0.6, swell=0.25, bend=0.8), pf.Stigma(1.0, 0.6))
    printed = pf.Pistil(pf.Ovary(r=3.0), pf.Style(r=2.0, swell=1.0, bend=3.0), pf.Stigma(2.4, 1.6))
    draw(
        "figure_5",
        [
            ("simple pistil", series(pf.pistils("simple", 1, carpel))),
            ("(a) apocarpous, 5 carpels", series(pf.pistils("apocarpous", 5, carpel))),
            ("(b) compound, 3 carpels", series(pf.pistils("compound", 3, carpel))),
            ("(c) compound, 6 carpels", series(pf.pistils("compound", 6, carpel))),
            ("printed constants (Eqs. 5, 6)", series(pf.pistils("simple", 1, printed))),
        ],
        5,
    )
    draw("stamens", [(kind, series(pf.stamens(kind))) for kind in STAMENS], 6, elevation=0.45)


def figure_6() -> None:
    """A rectangle becomes a peony petal: Eqs. 7 and 8."""
    petal = pf.PeonyPetal(rib_amplitude=0.5)
    bare = {"dx": 0.0, "dy": 0.0, "rib_amplitude": 0.0, "midrib_height": 0.0, "tip_curl": 0.0}
    steps = [
        ("rectangle", pf.Rectangle(petal.a_x, petal.b_y)),
        ("+ Δx", Widened()),
        ("+ Δy", Outline()),
        ("+ bend, dy", pf.PeonyPetal(**bare | {"dy": petal.dy})),
        ("+ ribs", pf.PeonyPetal(**bare | {"dy": petal.dy, "rib_amplitude": 0.5})),
        ("+ midrib, waves, curl", petal),
    ]
    fine = (161, 81)
    panels = [(title, [sheet(surface, resolution=fine)]) for title, surface in steps]
    draw("figure_6", panels, 6, azimuth=0.35, elevation=0.25)


def figure_7() -> None:
    """Patterns: Eq. 9 and Eq. 10."""
    dark, light = "#b3246a", "#fbe9ee"
    patterns = {
        "(a) centre: n 4, f ½, φ π/2": pf.RadialPattern(n=4.0, f=0.5, phi=np.pi / 2),
        "(b) side: n 4, f ½, φ 0": pf.RadialPattern(n=4.0, f=0.5, phi=0.0),
        "(c) ring: n 8, f 1, φ 0": pf.RadialPattern(n=8.0, f=1.0, phi=0.0),
        "(d) ribs: f 9": pf.RibPattern(i_2=2.2, f=9.0, n_1=0.5, n_2=0.5, k=0.5),
        "(e) ribs: f 21, to the base": pf.RibPattern(i_2=2.0, f=21.0, n_1=1.5, n_2=0.1, k=0.5),
        "(f) midrib: f 1, k 4": pf.RibPattern(i_2=2.0, f=1.0, n_1=0.5, n_2=0.3, k=4.0),
    }
    petal, fine = pf.PeonyPetal(rib_amplitude=0.1, midrib_height=0.5), (161, 81)
    panels = [
        (title, [sheet(petal, pf.Colour.of(light, dark, patterns=(pattern,)), resolution=fine)])
        for title, pattern in patterns.items()
    ]
    draw("figure_7", panels, 6, azimuth=0.0, elevation=0.1)


def figure_8() -> None:
    """The petals of a peony, from outside to inside."""
    peony = pf.peony()
    petals = peony.series[0]
    colour = petals.colours[""]
    chosen = np.linspace(0, len(petals) - 1, 6).astype(int)
    # All at one scale: a frame of two specks that no petal leaves.
    specks = [sheet(pf.Stigma(0.05, 0.05), colour, place, resolution=(5, 5))
              for place in ((-13.0, -12.0, 0.0), (13.0, 30.0, 0.0))]  # fmt: skip
    panels = [
        (f"petal {k + 1}", [sheet(petals.one(int(k)), colour, resolution=(129, 65)), *specks])
        for k in chosen
    ]
    draw("figure_8", panels, 6, azimuth=1.0, elevation=0.1)


def figure_9() -> None:
    """The peony, and the lily."""
    peony, lily = flower_sheets(pf.peony()), flower_sheets(pf.lily())
    figure = Figure(figsize=(10.4, 5.4))
    views = [(peony, 0.4, 1.05), (peony, 0.4, 0.3), (lily, 0.35, 0.55)]
    for number, (sheets, azimuth, elevation) in enumerate(views):
        axes = figure.add_axes((number / 3, 0.0, 1 / 3, 1.0))
        axes.imshow(portrait(sheets, (760, 500), azimuth, elevation), interpolation="antialiased")
        axes.set_axis_off()
    save(figure, "figure_9")


def scanned_flowers() -> None:
    """Scans of flowers, the petals that were found in them, grown again, and opened by 20° more."""
    figure = Figure(figsize=(9.6, 6.6))
    cases = [case for case in FLOWERS if case.name in ("flower-lily-table", "flower-peony")]
    for row, case in enumerate(cases):
        cloud = scan(case).cloud
        found = pf.fit_flower(cloud, model=pf.PeonyPetal, throw=False)
        seen = found.axis.into(cloud.points)
        colours = np.array([IGNORED, *map(of_petal, range(found.count))])[found.labels + 1]
        axes = [figure.add_subplot(len(cases), 4, 4 * row + k + 1) for k in range(4)]
        pictures.dots(axes[0], seen, c=GREY, s=1.5)
        pictures.dots(axes[1], seen, c=colours, s=1.5)
        again = found.flower()
        series = again.series[0]
        opening = np.asarray(series.attachment.opening) + np.radians(20)
        wider = dataclasses.replace(series.attachment, opening=opening)
        opened = dataclasses.replace(again, series=(dataclasses.replace(series, attachment=wider),))
        for place, flower in zip(axes[2:], (again, opened), strict=True):
            pictures.picture(place, flower_sheets(flower), 480)
        titles = ("the scan", f"{found.count} petals", "grown again", "opened by 20°")
        for place, title in zip(axes, titles, strict=True):
            place.set_title(title, color=GREY, fontsize=10)
    figure.tight_layout(pad=0.6)
    save(figure, "scanned_flowers")


if __name__ == "__main__":
    for make in (
        figure_1,
        figure_2,
        figure_3,
        figure_4,
        figure_5,
        figure_6,
        figure_7,
        figure_8,
        figure_9,
        scanned_flowers,
    ):
        make()
