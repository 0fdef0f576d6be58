"""Makes the pictures of the documentation: `python docs/figures.py`, or `make figures`."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

import petalfit as pf

FOLDER = Path(__file__).parent
PETAL = pf.PeonyPetal(a_x=15.0, b_y=36.0, dy=4.5, dx=0.3, rib_frequency=17.0, rib_amplitude=0.45)
VIEWS = {
    "from the front": (0.0, 0.0, 1.0),
    "obliquely": (0.6, -0.8, 1.2),
    "from the tip": (0.0, 1.0, 0.05),
}
GREY, ROSE, BLUE = "#7a7a80", "#c45a82", "#2e74b5"


def camera_of(eye: tuple[float, float, float]) -> pf.Camera:
    """An image that the petal fills to four fifths."""
    points = np.asarray(PETAL.mesh((33, 33)).vertices)
    middle = points.mean(axis=0)
    shape = (256, 256)
    camera = pf.Camera.look_at(middle + eye, middle, shape, pixels_per_unit=1.0)
    scale = 0.8 * 256 / np.ptp(camera.project(points), axis=0).max()
    return pf.Camera.look_at(middle + eye, middle, shape, pixels_per_unit=scale)


def identifiability(path: Path) -> None:
    """Three masks of one petal, and what each tells."""
    figure = Figure(figsize=(10.0, 6.2))
    names = [name for name, p in pf.parameters(PETAL).items() if not p.fixed]
    spread = {name: np.ptp(pf.parameters(PETAL)[name].typical) / 12**0.5 for name in names}
    for column, (title, eye) in enumerate(VIEWS.items()):
        camera = camera_of(eye)
        mask = PETAL.silhouette(camera).mask >= 0.5
        result = pf.fit_petal(mask, camera=camera)
        top = figure.add_subplot(2, 3, column + 1)
        rgba = np.zeros((*mask.shape, 4))
        rgba[mask] = (0.77, 0.35, 0.51, 0.8)
        top.imshow(rgba)
        top.set_axis_off()
        top.set_title(title, color=GREY, fontsize=11)
        bars = figure.add_subplot(2, 3, column + 4)
        for row, name in enumerate(names):
            known = result.identifiable[name]
            share = result.stderr[name] / spread[name] if known else 1.0
            bars.barh(row, max(share, 2e-4), left=0, color=BLUE if known else ROSE, height=0.6)
            if not known:
                bars.text(
                    0.9, row, "not determined", va="center", ha="right", fontsize=8, color="white"
                )
        bars.axvline(0.3, color=GREY, linewidth=1)
        bars.set_xscale("log")
        bars.set_xlim(2e-4, 1.0)
        bars.set_ylim(len(names) - 0.5, -0.5)
        bars.set_yticks(range(len(names)), names if column == 0 else [""] * len(names))
        bars.tick_params(colors=GREY, labelsize=9)
        for spine in bars.spines.values():
            spine.set_visible(False)
    figure.tight_layout()
    figure.savefig(path, dpi=120, transparent=True, metadata={"Software": "petalfit"})


def blades(path: Path) -> None:
    """Blades beside what they were fitted to; the shapes are third parties' and stay outside."""
    from petalfit.report import write_picture

    shapes = FOLDER.parents[1] / "shared" / "data"
    targets = ["scans/oceam_soybean_11_20190508T043118_pot1_15", "petals/tulip_rosaLjus_petal1"]
    if not shapes.exists():
        print(f"{path.name} needs {shapes}; it is left as it is.")
        return
    figure = Figure(figsize=(10.1, 9.2))
    for row, target in enumerate(targets):
        cloud = pf.PointCloud.load(shapes / f"{target}.ply")
        result = pf.fit_petal(cloud, model=pf.BladePetal, pose="similarity", throw=False)
        part = path.with_name(f"part-{row}.png")
        write_picture(result, part)
        axes = figure.add_axes((0.0, 0.5 * (1 - row), 1.0, 0.5))
        axes.imshow(imread(part), interpolation="antialiased")
        axes.set_axis_off()
        part.unlink()
    figure.savefig(path, dpi=110, transparent=True, metadata={"Software": "petalfit"})


if __name__ == "__main__":
    identifiability(FOLDER / "identifiability.png")
    blades(FOLDER / "blades.png")
