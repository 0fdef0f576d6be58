"""The cache of compiled programs: found again, bounded, and never in the way."""

import os
import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from petalfit.cli import compilation_cache as module
from petalfit.cli.compilation_cache import VARIABLE, compilation_cache, user_cache

NAME = "jax_compilation_cache_dir"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    reset_cache()
    yield tmp_path / "cache"
    reset_cache()


def compute() -> float:
    """Something to compile: a new function each time, but always the same program."""

    def program(x: jax.Array) -> jax.Array:
        return jnp.sum(jnp.cos(x) ** 2 + jnp.sin(x) ** 2)

    # What jax keeps in memory would not be looked for on disk; a new process has none of it.
    return float(jax.jit(program)(jnp.arange(11.0)))


def entries(root: Path) -> list[Path]:
    return sorted(root.glob("jaxlib-*/*program*"))


def test_programs_are_kept_and_settings_given_back(root: Path) -> None:
    before = {name: getattr(jax.config, name) for name in dir(jax.config) if "cache" in name}
    with compilation_cache() as compiled:
        assert not compiled
        assert compute() == pytest.approx(11.0)
    assert len(entries(root)) == 1
    assert before == {name: getattr(jax.config, name) for name in before}
    written = entries(root)[0].stat().st_mtime_ns
    with compilation_cache() as compiled:
        assert compiled
        compute()
    assert entries(root)[0].stat().st_mtime_ns == written
    assert entries(root)[0].parent.stat().st_mode & 0o077 == 0


def test_a_damaged_entry_is_no_trouble_and_replaced(root: Path) -> None:
    with compilation_cache():
        compute()
    (entry,) = entries(root)
    content = entry.read_bytes()
    entry.write_bytes(content[: len(content) // 2])
    with compilation_cache():  # warnings are errors here
        assert compute() == pytest.approx(11.0)
    with compilation_cache() as compiled:
        assert not compiled
        compute()
    assert len(entry.read_bytes()) > len(content) // 2


def test_a_folder_that_takes_nothing_is_no_trouble(root: Path) -> None:
    with compilation_cache():
        shutil.rmtree(root)
        assert compute() == pytest.approx(11.0)


def test_other_warnings_are_not_lost(root: Path) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with compilation_cache():
            warnings.warn("something else", UserWarning, stacklevel=1)
    assert [str(warning.message) for warning in caught] == ["something else"]


@pytest.mark.parametrize("value", ["", "{tmp}/file/below"], ids=["off", "impossible"])
def test_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(VARIABLE, value.format(tmp=tmp_path))
    with compilation_cache() as compiled:
        assert not compiled
        assert getattr(jax.config, NAME) is None
    assert os.listdir(tmp_path) == ["file"]


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in VARIABLE, "XDG_CACHE_HOME", "LOCALAPPDATA":
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", home)
    with compilation_cache():
        assert getattr(jax.config, NAME) is None


def test_oldest_files_go_first(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT", 1000)
    folder = root / "jaxlib-0.0-older"
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
