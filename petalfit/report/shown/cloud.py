"""Point clouds in a report, shown by a map of signed distances on the surface."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from petalfit.report.charts import map_chart
from petalfit.report.rounding import count, plain, share
from petalfit.report.scene import Scene, distance_limit, draw_map
from petalfit.report.shown.protocol import AbstractShown, histogram, in_noise
from petalfit.report.swatch import ignored
from petalfit.results import Agreement, FitRecord

_MAP = 680  # width in pixels; a pixel of the page has two of them


class ShownCloud(AbstractShown):
    """A cloud in a report: points in space, coloured by their distance."""

    in_scene: ClassVar[bool] = True

    def sentence(self, part: Agreement) -> str:
        used, outliers = int(np.count_nonzero(part.used)), part.outliers
        without = part.distances.size - used - outliers
        more = [f"{without:,} more without weight"] if without else []
        more += [f"{outliers:,} more taken for outliers"] if outliers else []
        apart = f" ({', '.join(more)})" if more else ""
        return (
            f"The points{apart} lie {plain(part.rms)} (rms{in_noise(part)}) from the surface, with noise "
            f"σ = {plain(part.noise)}, on a target {self._size(part)} in size."
        )

    def facts(self, part: Agreement) -> dict[str, str]:
        return {
            "points": f"{np.count_nonzero(part.used):,}",
            "target size": self._size(part),
            "rms distance": plain(part.rms),
            "noise σ": plain(part.noise),
        }

    def named(self, part: Agreement) -> str:
        return count(int(np.count_nonzero(part.used)), "point")

    def whole(self, part: Agreement) -> str:
        total, used = part.distances.size, int(np.count_nonzero(part.used))
        if total == used:
            return self.named(part)
        return f"{count(total, 'point')} ({used:,} of them used)"

    def distances(self, result: FitRecord, part: Agreement, scene: Scene | None) -> str:
        assert scene is not None, "a cloud has points"
        limit = distance_limit(part)
        picture = draw_map(scene, limit, _MAP)
        return (
            f'<div class="pair"><figure>{map_chart(picture, scene, limit, part.noise)}<figcaption>'
            f"The fitted outline and {share(picture.drawn, len(part.distances))} from the front, "
            "coloured by signed distance, positive on the side of the normal"
            f"{ignored(scene)}. Noise alone shows no pattern here.</figcaption></figure>"
            f"<div>{histogram(part)}</div></div>"
        )

    def _size(self, part: Agreement) -> str:
        return " × ".join(plain(side) for side in part.target.extent)
