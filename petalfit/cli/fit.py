"""`petalfit fit`: a fit of files, which gives named parameters, a mesh and a report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from petalfit.cli.options import Quiet, names_of, require_noise, require_seed
from petalfit.cli.status import NOT_CONVERGED, SUCCESS, CommandError, require

if TYPE_CHECKING:
    from petalfit.observations import Camera, PointCloud, Silhouette

Targets = Annotated[
    Positional[tuple[Path, ...]],
    arg(
        metavar="TARGET",
        help="Point cloud (.ply .xyz .txt .csv .npy .npz) or mesh (.ply .obj .stl .glb .gltf). Without "
        "--pose it is in the frame and unit of the model: its length along +y from the plane y = 0, its "
        "width along x. Or mask (.png .tif), white where the petal is, or with an alpha channel; "
        "`petalfit mask` makes one from a photo. Or the folder of a capture: transforms.json or a model "
        "of COLMAP, and masks or images. Several targets are fitted together.",
    ),
]
Cameras = Annotated[
    UseAppendAction[tuple[Path, ...]],
    arg(
        name="camera",
        metavar="CAMERA.json",
        help="Camera of the mask; repeat it for several masks, in their order. Or one transforms.json of "
        "a NeRF tool or model of COLMAP, which has the cameras of all masks by name. A "
        "single mask without a camera is a front view of unknown scale.",
    ),
]
Folder = Annotated[
    Path,
    arg(
        metavar="DIR",
        help="Folder for fit.json, fit.glb and report.html; it is created if it does not exist. Either "
        "all of them are written or none.",
    ),
]
ModelName = Annotated[
    str | None,
    arg(
        name="model",
        metavar="MODEL",
        help="Component to fit, by default a peony petal; `petalfit parameters MODEL` lists its "
        "parameters. auto fits all families of petals and keeps the one that explains a cloud best.",
    ),
]
PoseOption = Annotated[
    Literal["known", "rigid", "similarity"],
    arg(
        name="pose",
        help="known: the target is in the model's frame and unit; rigid: it is in the model's unit, but "
        "in any position; similarity: it is in any position and unit. rigid and similarity work for "
        "clouds of petals, and rigid also for masks with cameras.",
    ),
]
LossOption = Annotated[
    str,
    arg(
        name="loss",
        metavar="LOSS",
        help="linear if all points belong to the petal; robust if there may be outliers or clutter.",
    ),
]
Free = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        metavar="NAME",
        help="Parameter to fit; repeat it, or separate names by commas. The other parameters keep their "
        "defaults, or the values of --init. Without this option, all parameters are fitted that "
        "`petalfit parameters` does not call fixed.",
    ),
]
Init = Annotated[
    Path | None,
    arg(metavar="FIT.json", help="An earlier result to start from, instead of searching."),
]
Noise = Annotated[
    float | None,
    arg(
        metavar="SIGMA",
        help="Standard deviation of the noise of the points, in their unit; estimated if not given.",
    ),
]
BaseOption = Annotated[
    str | None,
    arg(
        name="base",
        metavar="X,Y,Z",
        help="A point near the base, in the frame of the cloud or the cameras, or `other`: the end that "
        "the fit would take for the tip. For blades with --pose rigid or similarity, whose ends may look "
        "alike. In a mask without a camera it is a place X,Y in pixels.",
    ),
]
EveryPoint = Annotated[
    bool,
    arg(
        name="every-point",
        help="Take every point of a large cloud in every step. It is slow, and changes the numbers by "
        "less than their errors.",
    ),
]
Profiles = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        metavar="NAME",
        help="Parameter whose profile likelihood the report shows; repeat it. Each one takes ten fits.",
    ),
]
Seed = Annotated[int, arg(metavar="S", help="Seed of the random choice of points for the starts.")]


def fit(
    targets: Targets,
    out: Folder,
    cameras: Cameras = (),
    model: ModelName = None,
    pose: PoseOption = "known",
    loss: LossOption = "linear",
    free: Free = (),
    init: Init = None,
    noise: Noise = None,
    profile: Profiles = (),
    seed: Seed = 0,
    base: BaseOption = None,
    every_point: EveryPoint = False,
    quiet: Quiet = False,
) -> int:
    """Recover the parameters of a petal from scans and silhouettes."""
    if noise is not None:
        require_noise(noise, least="a positive number, or leave it out")
    require_seed(seed)
    require(bool(targets), "there is no TARGET; give the file of a cloud, a mesh or a mask.")
    from petalfit.cli.console import (
        fit_table,
        list_files,
        output,
        progress,
        summarise,
        traits_table,
        warn,
    )
    from petalfit.cli.models import kind_of
    from petalfit.cli.results import CONTENTS, check_folder, write_results, written_whole
    from petalfit.compilation.cache import compilation_cache
    from petalfit.fitting.outliers.registry import loss_named

    check_folder(out)
    kind, place = kind_of(model), _base(base)
    loss_named(loss)
    with progress(quiet) as show:
        show(f"reading {', '.join(map(str, targets))}")
        read = _read(targets, cameras)
        with compilation_cache() as compiled:
            from petalfit.fitting import FitResult, fit_petal

            again = "" if compiled else " (compiling, which only the first fit needs)"
            result = fit_petal(
                read if len(read) > 1 else read[0],
                model=kind,
                pose=pose,
                loss=loss,
                free=names_of(free),
                init=None if init is None else FitResult.load(init),
                noise=noise,
                seed=seed,
                base=place,
                every_point=every_point,
                throw=False,
                progress=lambda text: show(text + again),
            )
            for name in names_of(profile) or []:
                result = result.with_profile(name, progress=show)
            show(f"writing {out}")
            with written_whole(out) as folder:
                write_results(result, folder)
            tables = [fit_table(result), *([traits_table(result)] if result.traits else [])]
    if not quiet:
        console = output()
        console.print(*tables, sep="\n")
        console.print(summarise(result, noise), soft_wrap=True)
        for name, found in result.profiles.items():
            low, high = found.interval()
            console.print(f"{name}: 95 % profile interval {low:.6g} to {high:.6g}", soft_wrap=True)
        list_files(out, CONTENTS)
    warn(result)
    return SUCCESS if result.converged else NOT_CONVERGED


def _read(targets: tuple[Path, ...], cameras: tuple[Path, ...]) -> "list[PointCloud | Silhouette]":
    """Reads all target files, masks with their cameras, and folders of captures."""
    from petalfit.observations import is_mask_file, read_targets

    masks = [path for path in targets if is_mask_file(path)]
    require(
        bool(masks) or not cameras, "--camera is for masks, and there is none among the targets."
    )
    seen = dict(zip(masks, _cameras(masks, cameras), strict=True))
    return [target for path in targets for target in read_targets(path, seen.get(path))]


def _cameras(masks: list[Path], files: tuple[Path, ...]) -> "list[Camera | None]":
    """A camera for each mask, or None for every mask."""
    from petalfit.observations import Camera, cameras_of, read_frames

    if not files:
        return [None] * len(masks)
    found = [read_frames(path) for path in files]
    if len(found) == 1 and isinstance(found[0], list):
        return [*cameras_of(masks, found[0], files[0])]
    require(
        len(found) == len(masks) and all(isinstance(camera, Camera) for camera in found),
        f"{len(files)} --camera for {len(masks)} masks: give one for each, in the same order, or a "
        "single transforms.json or model of COLMAP.",
    )
    return [camera for camera in found if isinstance(camera, Camera)]


def _base(text: str | None) -> Any:
    """The value of --base: a point, "other" or None."""
    if text is None or text == "other":
        return text
    try:
        return tuple(map(float, text.split(",")))
    except ValueError:
        raise CommandError(
            f"--base {text} is no place; write --base 0.5,0,-2, or --base other."
        ) from None
