"""The hash of what was fitted: of its numbers, and of nothing else."""

import dataclasses

import numpy as np

from petalfit import Camera, FitResult, PointCloud, Silhouette
from petalfit.observations import Contour
from petalfit.results import Agreement
from tests.fitted import changed, known_pose

CAMERA = Camera.look_at((30, -40, 70), (0, 12, 0), (40, 50), field_of_view=0.6)


def of(*targets: PointCloud | Silhouette) -> FitResult:
    parts = []
    for target in targets:
        n = len(target if isinstance(target, PointCloud) else Contour.of(target).place)
        parts.append(Agreement(target, np.zeros(n), np.ones(n), 0.1))
    parts = tuple(parts)
    return dataclasses.replace(known_pose(), agreements=parts)


def mask(value: float = 0.3, camera: Camera | None = CAMERA) -> Silhouette:
    cover = np.zeros((40, 50))
    cover[10:30, 10:30] = value
    cover[12:28, 12:28] = 1.0
    return Silhouette(cover, camera, np.where(cover > 0, 1 / 3, 1.0))


def test_saving_and_loading_keep_it(tmp_path):
    cloud = known_pose().agreements[0].target
    for result in (known_pose(), of(mask()), of(mask(camera=None), cloud), of(cloud, mask(0.4))):
        result.save(tmp_path / "fit.json")
        assert FitResult.load(tmp_path / "fit.json").input_hash == result.input_hash


def test_every_number_counts():
    points = known_pose().agreements[0].target.points
    moved = points.copy()
    moved[7, 1] = np.nextafter(moved[7, 1], np.inf)
    targets = [
        [PointCloud(points)],
        [PointCloud(moved)],
        [PointCloud(points, weights=np.ones(len(points)))],
        [PointCloud(points[::-1])],
        [PointCloud(points), PointCloud(points)],
        [mask()],
        [mask(0.4)],
        [mask(camera=None)],
    ]
    assert len({of(*some).input_hash for some in targets}) == len(targets)


def test_what_was_found_does_not_count():
    other = changed(known_pose(), noise=0.2, reason="something else", command="petalfit fit x")
    assert other.input_hash == known_pose().input_hash
    assert len(other.input_hash) == 64
