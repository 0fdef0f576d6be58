"""Every file of a folder beside what was fitted to it: `python docs/contact_sheet.py FOLDER sheet.png`.

Clouds and meshes in any pose and unit; a line a file with the mean distances to the model and from it, in
percent of the diagonal, and a picture with the points, those taken for outliers in red, and the fitted
surface as a grid.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.figure import Figure
from scipy.spatial import KDTree

import petalfit as pf

SHOWN = 1500  # points
COLUMNS = 4
LOOKS = (np.array([[1, 0, 0], [0, 1, 0]]), np.array([[0.8, 0, 0.6], [-0.3, 0.87, 0.4]]))


def distances(path: Path, result: pf.FitResult) -> tuple[float, float]:
    """Mean distances to the model and from it, in percent of the target's diagonal."""
    part = result.agreements[0]
    used = part.target.points[part.used]
    size = float(np.linalg.norm(np.ptp(used, axis=0)))
    forth = float(np.abs(part.distances[part.used]).mean())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        own = trimesh.load(path, process=False)
    there = trimesh.sample.sample_surface(result.mesh((129, 129)), 3000, seed=0)[0]
    if isinstance(own, trimesh.Trimesh) and len(own.faces):
        dense = trimesh.sample.sample_surface(own, 200_000, seed=1)[0]
        back = KDTree(dense).query(there)[0]
    else:
        # A cloud has gaps between its points: to the planes through the nearest of them.
        _, near = KDTree(used).query(there, 8)
        middle = used[near].mean(axis=1)
        normal = np.linalg.svd(used[near] - middle[:, None])[2][:, 2]
        beside = np.linalg.norm(there - used[near[:, 0]], axis=1)
        flat = np.abs(np.sum((there - middle) * normal, axis=1))
        spacing = np.median(KDTree(used).query(used, 5)[0][:, 4])
        back = np.where(beside < 2 * spacing, flat, beside)
    return 100 * forth / size, 100 * float(np.mean(back)) / size


def draw(axes: tuple, result: pf.FitResult, title: str) -> None:
    """Two looks at the points and the surface."""
    part = result.agreements[0]
    points, used = part.target.points, part.used
    centre = points[used].mean(axis=0)
    _, turned = np.linalg.eigh(np.cov((points[used] - centre).T))
    grid = (np.array(result.mesh((17, 17)).vertices) - centre) @ turned[:, ::-1]
    grid = grid.reshape(17, 17, 3)
    points = (points - centre) @ turned[:, ::-1]
    some = np.random.default_rng(0).permutation(len(points))[:SHOWN]
    for look, box in zip(LOOKS, axes, strict=True):
        for flag, colour, dot in ((True, "#2a8a4a", 1.0), (False, "#d03030", 4.0)):
            chosen = some if flag else np.arange(len(points))
            shown = points[chosen[used[chosen] == flag]] @ look.T
            box.scatter(*shown.T, s=dot, c=colour, linewidths=0)
        for lines in (grid, grid.swapaxes(0, 1)):
            for line in lines[::2]:
                box.plot(*(line @ look.T).T, color="#222", linewidth=0.4)
        box.set_aspect("equal")
        box.set_axis_off()
    axes[0].set_title(title, fontsize=6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of .ply files")
    parser.add_argument("sheet", type=Path, help="picture to write")
    parser.add_argument("--model", default="BladePetal", help="BladePetal or SplinePetal")
    parser.add_argument("--loss", default="linear", help="robust where there are outliers")
    arguments = parser.parse_args()
    files = sorted(arguments.folder.glob("*.ply"))
    rows = -(-len(files) // COLUMNS)
    figure = Figure(figsize=(5.6 * COLUMNS, 2.6 * rows))
    boxes = figure.subplots(rows, 2 * COLUMNS, squeeze=False).reshape(-1, 2)
    for box in boxes.ravel():
        box.set_axis_off()
    found = []
    for path, pair in zip(files, boxes, strict=False):
        cloud = pf.PointCloud.load(path, n=2000)
        kind = getattr(pf, arguments.model)
        result = pf.fit_petal(
            cloud, model=kind, pose="similarity", loss=arguments.loss, throw=False
        )
        there, back = distances(path, result)
        found.append(max(there, back))
        outliers = result.agreements[0].outliers
        line = f"{path.stem}: {there:.2f} %, {back:.2f} %, {outliers} outliers, {result.status}"
        print(line, flush=True)
        draw(pair, result, line)
    print(f"greater of both ways: median {np.median(found):.2f} %, worst {max(found):.2f} %")
    figure.tight_layout()
    figure.savefig(arguments.sheet, dpi=60)


if __name__ == "__main__":
    main()
