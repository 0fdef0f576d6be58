"""The cache of compiled programs: found again, bounded, and never in the way."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from petalfit.compilation import ExecutableStore, Program, store, use_store, watched
from petalfit.compilation import cache as module
from petalfit.compilation.cache import (
    VARIABLE,
    compilation_cache,
    open_to_others,
    user_cache,
)

TRACED = []


def _sum_of_squares(x: dict) -> dict:
    TRACED.append(x)
    matrix = jnp.outer(x["a"], x["a"]) + jnp.eye(11)
    return {"sum": jnp.sum(jnp.linalg.cholesky(matrix) ** 2)}


# As if it were petalfit's: only such programs are kept.
_sum_of_squares.__module__ = "petalfit.made_up"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    TRACED.clear()
    return tmp_path / "cache"


def compute() -> None:
    """Something to compile, with LAPACK in it, as if in a new process."""
    result = Program(_sum_of_squares)({"a": np.arange(11.0, dtype=np.float32)})
    assert float(result["sum"]) == pytest.approx(11 + 385, rel=1e-5)


def entries(root: Path) -> list[Path]:
    return sorted(root.glob("programs-*/sum_of_squares-*"))


def test_programs_are_kept(root: Path) -> None:
    with compilation_cache() as compiled:
        assert not compiled
        compute()
        compute()
    assert len(TRACED) == len(entries(root)) == 1
    written = entries(root)[0].stat().st_mtime_ns
    with compilation_cache() as compiled:
        assert compiled
        compute()
    assert len(TRACED) == 1
    assert entries(root)[0].stat().st_mtime_ns == written
    assert entries(root)[0].parent.stat().st_mode & 0o077 == 0


def test_options_that_the_compiler_does_not_know_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store.options.cache_clear()
    known = store.options()
    # Which of them this version of XLA knows is its affair, but it knows one.
    assert known
    assert known.items() <= store._OPTIONS.items()
    monkeypatch.setattr(store, "_OPTIONS", store._OPTIONS | {"xla_of_the_past": True})
    store.options.cache_clear()
    try:
        assert store.options() == known
    finally:
        store.options.cache_clear()


class Scaled(eqx.Module):
    """Somebody's own surface, say."""

    by: float


def _scaled(x: Scaled) -> jnp.ndarray:
    return jnp.asarray(x.by) * 2


def test_what_is_not_petalfits_is_not_kept(root: Path) -> None:
    def tripled(x: np.ndarray) -> jnp.ndarray:
        return 3 * jnp.asarray(x)

    with compilation_cache():
        assert float(Program(tripled)(np.float32(2))) == 6
        _scaled.__module__ = "petalfit.made_up"
        assert float(Program(_scaled)(Scaled(np.float32(2)))) == 4  # pyright: ignore
    assert not [*root.glob("programs-*/*")]


def test_another_source_is_another_program(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with compilation_cache():
        compute()
    monkeypatch.setattr("petalfit.compilation.store._versions", lambda: "a later version")
    with compilation_cache():
        compute()
    assert len(TRACED) == len(entries(root)) == 2


def test_a_damaged_entry_is_no_trouble_and_replaced(root: Path) -> None:
    with compilation_cache():
        compute()
    (entry,) = entries(root)
    content = entry.read_bytes()
    entry.write_bytes(content[: len(content) // 2])
    with compilation_cache():
        compute()
    assert len(TRACED) == 2
    with compilation_cache():
        compute()
    assert len(TRACED) == 2
    assert len(entry.read_bytes()) > len(content) // 2


def test_a_folder_that_takes_nothing_is_no_trouble(root: Path) -> None:
    with compilation_cache():
        shutil.rmtree(root)
        compute()


@pytest.mark.parametrize("value", ["", "{tmp}/file/below"], ids=["off", "impossible"])
def test_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(VARIABLE, value.format(tmp=tmp_path))
    with compilation_cache() as compiled:
        assert not compiled
        compute()
    assert os.listdir(tmp_path) == ["file"]


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in VARIABLE, "XDG_CACHE_HOME", "LOCALAPPDATA":
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", home)
    with compilation_cache():
        compute()


def test_oldest_files_go_first(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT", 1000)
    folder = root / "programs-older"
    folder.mkdir(parents=True)
    for age in range(12):
        file = folder / f"{age:02}-cache"
        file.write_bytes(b"." * 100)
        os.utime(file, (1e9 - age, 1e9 - age))
    with compilation_cache():
        pass
    assert sorted(path.name for path in folder.iterdir()) == [f"{age:02}-cache" for age in range(5)]


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/x"}, Path("/x/petalfit")),
        ("linux", {}, Path.home() / ".cache/petalfit"),
        ("darwin", {"XDG_CACHE_HOME": "/x"}, Path.home() / "Library/Caches/petalfit"),
        ("win32", {"LOCALAPPDATA": "/l"}, Path("/l/petalfit")),
    ],
)
def test_user_cache(
    monkeypatch: pytest.MonkeyPatch, platform: str, variables: dict[str, str], expected: Path
) -> None:
    for name in "XDG_CACHE_HOME", "LOCALAPPDATA":
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.platform", platform)
    assert user_cache() == expected


def test_processor_is_part_of_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    read: Callable[..., str] = Path.read_text
    here = module._processor()
    assert here == module._processor()
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr(Path, "read_text", lambda self, **_: "model name : other\nflags : sse2\n")
    assert module._processor() != here
    monkeypatch.setattr(Path, "read_text", read)


def test_without_a_store_a_program_compiles_once_and_says_so() -> None:
    def cubes(x: np.ndarray) -> jnp.ndarray:  # which nobody has compiled before
        return jnp.sum(jnp.asarray(x) ** 3)

    program = Program(cubes)
    times = []
    with use_store(ExecutableStore(None)):
        for _ in range(2):
            with watched("computing") as watch:
                program(np.arange(11.0, dtype=np.float32))
            times.append(watch.seconds)
    first, second = times
    assert first["compiling"] > 0
    assert "compiling" not in second


@pytest.mark.skipif(os.name == "nt", reason="permissions are others there")
@pytest.mark.parametrize("of_parent", [False, True], ids=["folder", "parent"])
def test_a_folder_that_others_may_write_to_is_not_read(
    root: Path, of_parent: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with compilation_cache():
        compute()
    (entry,) = entries(root)
    place = root if of_parent else entry.parent
    place.chmod(0o770)
    module._say_once.cache_clear()
    for _ in range(2):
        with compilation_cache() as compiled:
            assert not compiled
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"others may write to {place}, so compiled programs are neither read nor kept" in said
    place.chmod(0o700)
    with compilation_cache() as compiled:
        assert compiled


@pytest.mark.skipif(os.name == "nt", reason="permissions are others there")
def test_a_folder_of_somebody_else_is_not_read(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root.mkdir()
    assert open_to_others(root) == ""
    if os.geteuid() == 0:
        os.chown(root, 12345, 12345)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert "belongs to somebody else" in open_to_others(root)


def test_folders_are_made_for_the_user_alone(root: Path) -> None:
    with compilation_cache():
        compute()
    assert root.stat().st_mode & 0o077 == 0
