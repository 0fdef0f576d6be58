"""Every test runs with petalfit's shapes and types checked as it goes."""

import ctypes
import gc
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

from tests.browser import browser as browser

# Before anything imports petalfit: what is imported earlier stays unchecked.
install_import_hook("petalfit", "beartype.beartype")

# Compilation makes a first example slow, so no deadlines. The same examples are tried every time and
# everywhere; `pytest --hypothesis-profile explore` tries others.
settings.register_profile("default", deadline=None, derandomize=True, database=None)
settings.register_profile("explore", deadline=None, print_blob=True)
settings.load_profile("default")


# What Program asks of the compiler, for programs that do not come from one: two fifths less to wait for.
_FLAGS = ("--xla_llvm_disable_expensive_passes=true", "--xla_cpu_use_fusion_emitters=false")


def _known_flags() -> list[str]:
    """Those that this version of XLA knows: one that it does not know ends a process."""

    def survives(flag: str) -> bool:
        command = [sys.executable, "-c", "import jax; jax.numpy.ones(1)"]
        done = subprocess.run(command, env=os.environ | {"XLA_FLAGS": flag}, capture_output=True)
        return done.returncode == 0

    return [flag for flag in _FLAGS if survives(flag)]


def pytest_configure(config: pytest.Config) -> None:
    """What one process has compiled the others load: those that run tests, and those that tests start."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        return
    folder = tempfile.TemporaryDirectory(prefix="petalfit-")
    patch = pytest.MonkeyPatch()
    patch.setenv("PETALFIT_CACHE", folder.name)
    patch.setenv("XLA_FLAGS", " ".join([os.environ.get("XLA_FLAGS", ""), *_known_flags()]).strip())
    # A thread for each core in each of as many processes would wait for the others, spinning.
    patch.setenv("OPENBLAS_NUM_THREADS", os.environ.get("OPENBLAS_NUM_THREADS", "1"))
    # A thread for each core in each of as many processes would wait for the others, spinning.
    patch.setenv("OPENBLAS_NUM_THREADS", os.environ.get("OPENBLAS_NUM_THREADS", "1"))
    config.add_cleanup(folder.cleanup)
    config.add_cleanup(patch.undo)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Some tests compute what they are parametrised with."""
    with _programs():
        return (yield)


@pytest.fixture(autouse=True, scope="session")
def programs_in_common() -> Iterator[None]:
    """For fixtures that several files share."""
    with _programs():
        yield


@pytest.fixture(autouse=True, scope="module")
def programs_of_a_file(programs_in_common: None) -> Iterator[None]:
    """Programs leave the memory with the file that needed them; the next one finds them in the folder."""
    import jax

    with _programs():
        yield
    jax.clear_caches()
    gc.collect()
    # What the compiler has freed glibc keeps: two thirds of a process that compiled hundreds of programs.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def _programs() -> AbstractContextManager[bool]:
    from petalfit.compilation.cache import compilation_cache

    return compilation_cache()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take longest come first, so that no process is left alone with one of them."""
    order = {name: place for place, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))


_LONGEST = (
    "test_documentation.py",
    "test_silhouettes.py",
    "test_anywhere.py",
    "test_sheets.py",
    "test_colours.py",
    "test_organs.py",
    "test_folder.py",
    "test_browser.py",
    "test_many.py",
    "test_fit.py",
    "test_recovery.py",
    "test_view_pose.py",
    "test_surface.py",
    "test_flower.py",
    "test_implicit.py",
)
