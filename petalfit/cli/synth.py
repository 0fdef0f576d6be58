"""`petalfit synth`: a cloud or a mesh of a petal with given parameters."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import UseAppendAction, arg

from petalfit.cli.options import require_noise, require_seed, setting_value
from petalfit.cli.status import SUCCESS, CommandError, require

if TYPE_CHECKING:
    from petalfit.components import PeonyPetal

CLOUDS = (".ply", ".xyz", ".csv", ".npy", ".npz")
MESHES = (".glb", ".obj", ".stl")


File = Annotated[
    Path,
    arg(
        aliases=["-o"],
        metavar="FILE",
        help="File to write: a cloud (.ply .xyz .csv .npy .npz) or a mesh (.glb .obj .stl).",
    ),
]
Settings = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        name="set",
        metavar="NAME=VALUE",
        help="A parameter's value; repeat it. `petalfit parameters` lists names and defaults.",
    ),
]
Points = Annotated[
    int | None, arg(metavar="N", help="Number of points of a cloud; the default is 1500.")
]
Noise = Annotated[
    float, arg(metavar="SIGMA", help="Standard deviation of every coordinate of a cloud.")
]
Seed = Annotated[int, arg(metavar="S", help="Seed of the random points and their noise.")]


def synth(
    out: File, settings: Settings = (), points: Points = None, noise: Noise = 0.0, seed: Seed = 0
) -> int:
    """Make a petal from named parameters, as a cloud or as a mesh."""
    suffix = out.suffix.lower()
    require(
        suffix in CLOUDS + MESHES,
        f"{out} has the unknown suffix {suffix!r}; clouds are {' '.join(CLOUDS)}, meshes "
        f"{' '.join(MESHES)}.",
    )
    is_mesh = suffix in MESHES
    require(
        not (is_mesh and (noise or points is not None)),
        f"{out} is a mesh, which has no --points and no --noise; a cloud is one of "
        f"{' '.join(CLOUDS)}.",
    )
    require(points is None or points >= 3, f"--points {points} are too few; give 3 or more.")
    require_noise(noise)
    require_seed(seed)
    from petalfit.cli.console import output
    from petalfit.compilation.cache import compilation_cache

    with compilation_cache():
        petal = _petal(settings)
        count = 1500 if points is None else points
        try:
            if is_mesh:
                _write_mesh(petal, out)
            else:
                petal.sample(count, seed=seed, noise=noise).save(out)
        except OSError as error:
            reason = error.strerror or error
            raise CommandError(f"{out} cannot be written ({reason}); nothing was.") from error
    what = "mesh" if is_mesh else f"{count} points"
    values = ", ".join(f"{name} {float(value):g}" for name, value in vars(petal).items())
    output().print(f"{out}: {what} of a peony petal, {values}", soft_wrap=True)
    return SUCCESS


def _petal(settings: tuple[str, ...]) -> "PeonyPetal":
    from petalfit.components import PeonyPetal, parameters

    declared = parameters(PeonyPetal)
    values = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        require(bool(equals), f"--set {setting} has no value; write --set {name or 'a_x'}=14.")
        require(
            name in declared,
            f"--set {setting} names no parameter; the parameters are {', '.join(declared)}.",
        )
        values[name] = setting_value(setting, name, text, "14")
        low, high = declared[name].bounds
        require(
            low < values[name] < high,
            f"--set {setting} lies outside the range of {name}, which is ({low:g}, {high:g}).",
        )
    return PeonyPetal(**values)


def _write_mesh(petal: "PeonyPetal", path: Path) -> None:
    from petalfit.export import obj_text
    from petalfit.observations.atomic import atomic_path

    mesh, suffix = petal.mesh(), path.suffix.lower()
    if suffix == ".obj":
        content = obj_text(mesh).encode()
    elif suffix == ".glb":
        content = mesh.export(file_type="glb", include_normals=True)
    else:
        content = mesh.export(file_type="stl")
    assert isinstance(content, bytes)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
