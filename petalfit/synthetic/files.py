"""Files of synthetic cases: one folder per case with cloud, masks and truth, and one manifest.

The same recipe gives the same bytes on every machine.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from petalfit.components import PeonyPetal
from petalfit.flowers import save_flower
from petalfit.observations import Camera, PointCloud, Silhouette, read_cameras
from petalfit.observations.atomic import atomic_path
from petalfit.synthetic.case import Case, make, make_masks
from petalfit.synthetic.flower_case import FlowerCase, Scan, scan
from petalfit.synthetic.recipes import FLOWERS, RECIPES
from petalfit.synthetic.sight import Sight

MANIFEST = "manifest.json"
CASES = "cases"
TRUTH = "truth.json"


def write_cases(
    folder: Path, recipes: Iterable[Case] = RECIPES, flowers: Iterable[FlowerCase] = FLOWERS
) -> list[Path]:
    """Makes all cases and the manifest.

    Args:
        folder: The folder for `cases/<name>/`, with the files of `write_case` or `write_flower_case`, and
            `manifest.json`.
        recipes: The cases of petals to make.
        flowers: The cases of flowers to make.

    Returns:
        The paths of the written files, the manifest last.
    """
    written: list[Path] = []
    listed: dict[str, list[dict[str, object]]] = {"cases": [], "flowers": []}

    def note(kind: str, files: list[Path], truth: dict[str, object]) -> None:
        digests = {path.relative_to(folder).as_posix(): _sha256(path) for path in files}
        listed[kind].append(truth | {"files": digests})
        written.extend(files)

    for case in recipes:
        place = _place(folder, case.name)
        note("cases", write_case(case, make(case) if case.points else None, place), _truth(case))
    for case in flowers:
        files = write_flower_case(case, scan(case), _place(folder, case.name))
        note("flowers", files, dataclasses.asdict(case))
    _write_json(listed, folder / MANIFEST)
    return [*written, folder / MANIFEST]


def _place(folder: Path, name: str) -> Path:
    place = folder / CASES / name
    place.mkdir(parents=True, exist_ok=True)
    return place


def write_case(case: Case, cloud: PointCloud | None, folder: Path) -> list[Path]:
    """Writes one case into an existing folder, for `read_case`.

    Returns:
        The paths of `cloud.*`, of `mask-1.png` with `camera-1.json` and so on, as far as the case has
        them, and of `truth.json`.
    """
    files = []
    if cloud is not None:
        files.append(folder / f"cloud{case.suffix}")
        _write_cloud(cloud, files[0])
    for number, (sight, mask) in enumerate(zip(case.sights, make_masks(case), strict=True), 1):
        camera = folder / f"camera-{number}.json"
        mask.save(folder / f"mask-{number}.png")
        _write_json(sight.camera_json(), camera)
        files += [folder / f"mask-{number}.png", camera]
    files.append(folder / TRUTH)
    _write_json(_truth(case), files[-1])
    return files


def write_flower_case(case: FlowerCase, scanned: Scan, folder: Path) -> list[Path]:
    """Writes one case of a flower into an existing folder, for `read_flower_case`.

    Returns:
        The paths of `cloud.npz`, of `labels.npy` with the petal of every point (int8, −1 for none), of
        `flower.json` with all parameters of the flower in its own frame, and of `truth.json`.
    """
    cloud, labels, flower, truth = (
        folder / name for name in ("cloud.npz", "labels.npy", "flower.json", TRUTH)
    )
    _write_cloud(scanned.cloud, cloud)
    with atomic_path(labels) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array(file, scanned.labels.astype("<i1"), version=(1, 0))
    save_flower(case.flower(), flower)
    _write_json(dataclasses.asdict(case), truth)
    return [cloud, labels, flower, truth]


def read_flower_case(folder: Path) -> tuple[FlowerCase, Scan]:
    """Reads a case of a flower from its folder: the recipe, and the scan."""
    truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
    truth["views"] = tuple(map(tuple, truth["views"]))
    truth["turn"] = tuple(truth["turn"])
    labels = np.load(folder / "labels.npy", allow_pickle=False).astype(int)
    return FlowerCase(**truth), Scan(PointCloud.load(folder / "cloud.npz"), labels)


def check_cases(
    folder: Path, recipes: Iterable[Case] = RECIPES, flowers: Iterable[FlowerCase] = FLOWERS
) -> list[str]:
    """Compares the files of a folder with its manifest, and with what the recipes make now.

    Args:
        folder: The folder that `write_cases` has written.
        recipes: The cases of petals that it was made from.
        flowers: The cases of flowers that it was made from.

    Returns:
        One line for each difference; empty if there is none.
    """
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    listed = {
        name: digest
        for entry in [*manifest["cases"], *manifest["flowers"]]
        for name, digest in entry["files"].items()
    }
    there = {path.relative_to(folder).as_posix() for path in folder.glob(f"{CASES}/*/*")}
    wrong = [f"{name} is missing" for name in sorted(listed.keys() - there)]
    wrong += [f"{name} is not in the manifest" for name in sorted(there - listed.keys())]
    wrong += [
        f"{name} is not what the manifest says"
        for name in sorted(listed.keys() & there)
        if _sha256(folder / name) != listed[name]
    ]
    with tempfile.TemporaryDirectory() as temporary:
        for path in write_cases(Path(temporary), recipes, flowers):
            name = path.relative_to(temporary)
            if (folder / name).is_file() and (folder / name).read_bytes() != path.read_bytes():
                wrong.append(f"{name.as_posix()} comes out different when it is made again")
    return wrong


def read_case(folder: Path) -> tuple[Case, list[PointCloud | Silhouette]]:
    """Reads a case from its folder: the recipe, and its targets, the cloud first."""
    truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
    truth["model"] = PeonyPetal(**truth.pop("parameters"))
    if truth["keep"] is not None:
        truth["keep"] = (tuple(truth["keep"]["normal"]), truth["keep"]["offset"])
    truth["sights"] = tuple(map(_sight, truth["sights"]))
    for name in ("hidden", "turn", "shift"):
        truth[name] = None if truth[name] is None else tuple(truth[name])
    case = Case(**truth)
    targets: list[PointCloud | Silhouette] = []
    if case.points:
        targets.append(PointCloud.load(folder / f"cloud{case.suffix}"))
    for number in range(1, len(case.sights) + 1):
        camera = read_cameras(folder / f"camera-{number}.json")
        assert isinstance(camera, Camera)
        targets.append(Silhouette.load(folder / f"mask-{number}.png", camera))
    return case, targets


def _sight(fields: dict[str, Any]) -> Sight:
    """A sight from its JSON, in which lists stand for tuples."""
    tuples: dict[str, Any] = {name: tuple(x) for name, x in fields.items() if isinstance(x, list)}
    return Sight(**fields | tuples)


def _truth(case: Case) -> dict[str, object]:
    """A case as JSON: its fields, and the parameters of its model by name."""
    truth = {field.name: getattr(case, field.name) for field in dataclasses.fields(case)}
    truth["model"] = type(case.model).__name__
    truth["parameters"] = {name: float(value) for name, value in vars(case.model).items()}
    if case.keep is not None:
        truth["keep"] = {"normal": case.keep[0], "offset": case.keep[1]}
    truth["sights"] = [dataclasses.asdict(sight) for sight in case.sights]
    return truth


def _write_json(content: Mapping[str, object], path: Path) -> None:
    with atomic_path(path) as temporary:
        text = json.dumps(content, indent=1) + "\n"
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _write_cloud(cloud: PointCloud, path: Path) -> None:
    if path.suffix != ".npz":
        cloud.save(path)
        return
    # Written by hand: NumPy's archive depends on the operating system, its compression on zlib's version.
    array = io.BytesIO()
    np.lib.format.write_array(array, cloud.points.astype("<f4"), version=(1, 0))
    member = zipfile.ZipInfo("points.npy", date_time=(1980, 1, 1, 0, 0, 0))
    member.create_system = 3
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr(member, array.getvalue())


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
