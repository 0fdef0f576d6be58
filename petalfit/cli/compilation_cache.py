"""Compiled programs kept between processes: the second `petalfit fit` does not compile again.

They lie in a folder of the user's cache, one for each version of jaxlib and kind of processor, and
are removed, the oldest first, when all of them together grow past `LIMIT`. The environment variable
PETALFIT_CACHE names another folder; empty, it turns the cache off. A folder that cannot be used
costs time and nothing else.
"""

import hashlib
import os
import platform
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

VARIABLE = "PETALFIT_CACHE"
# One size of cloud needs about 2 MB. jax's own limit would need another package, filelock.
LIMIT = 256_000_000
_TROUBLE = "Error (reading|writing) persistent compilation cache entry"


@contextmanager
def compilation_cache() -> Iterator[bool]:
    """While the block runs, jax compiles into the cache and out of it.

    Yields:
        Whether compiled programs may be there already; if not, the user has to wait.
    """
    import jax

    settings = {
        "jax_compilation_cache_dir": _usable_folder(),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
        "jax_persistent_cache_enable_xla_caches": "none",  # those are for GPUs
    }
    before = {name: getattr(jax.config, name) for name in settings}
    folder = settings["jax_compilation_cache_dir"]
    if folder is None:
        yield before["jax_compilation_cache_dir"] is not None
        return
    _update(settings)
    try:
        with _heeding_trouble(Path(folder)):
            yield any(Path(folder).iterdir())
    finally:
        _update(before)


def _update(settings: dict[str, object]) -> None:
    import jax

    for name, value in settings.items():
        jax.config.update(name, value)


def _usable_folder() -> str | None:
    """The folder of this jaxlib and processor, made if need be; None for no cache of ours."""
    root = os.environ.get(VARIABLE)
    # Somebody who set up jax's cache wants it used.
    if root == "" or (root is None and os.environ.get("JAX_COMPILATION_CACHE_DIR")):
        return None
    try:
        root = user_cache() if root is None else Path(root).absolute()
        folder = root / f"jaxlib-{version('jaxlib')}-{_processor()}"
        # Whoever can write there can make us run anything.
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _prune(root)
    except (OSError, RuntimeError):  # RuntimeError: of a user without a home
        return None
    return str(folder) if os.access(folder, os.R_OK | os.W_OK | os.X_OK) else None


def user_cache() -> Path:
    """Where this platform keeps what can be made again."""
    match sys.platform:
        case "win32":
            base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        case "darwin":
            base = Path.home() / "Library" / "Caches"
        case _:
            base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "petalfit"


def _processor() -> str:
    """Twelve digits that change with the instructions that a compiled program may use."""
    described = [sys.platform, platform.machine()]
    with suppress(OSError, subprocess.SubprocessError):
        if sys.platform == "linux":
            text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
            lines = re.findall(r"(?m)^(?:model name|flags|Features|CPU part)\s*:.*$", text)
            described += sorted(set(lines))
        elif sys.platform == "darwin":
            command = ["sysctl", "-n", "machdep.cpu.brand_string"]
            described += [subprocess.run(command, capture_output=True, text=True, timeout=5).stdout]
        else:
            described += [platform.processor()]
    return hashlib.sha256("\n".join(described).encode()).hexdigest()[:12]


def _prune(root: Path) -> None:
    """Removes the oldest files if there is too much, down to half of the limit."""
    status = {path: path.stat() for path in root.glob("jaxlib-*/*")}
    size = sum(entry.st_size for entry in status.values())
    if size <= LIMIT:
        return
    for path in sorted(status, key=lambda path: status[path].st_mtime):
        path.unlink(missing_ok=True)
        size -= status[path].st_size
        if size <= LIMIT // 2:
            break


@contextmanager
def _heeding_trouble(folder: Path) -> Iterator[None]:
    """Keeps jax's warnings about the cache from the user, and empties a cache that is damaged.

    jax never replaces an entry, so one cut short, by a full disk say, would stay so.
    """
    unreadable = []
    with warnings.catch_warnings():
        warnings.filterwarnings("always", _TROUBLE)
        show = warnings.showwarning

        def note(message, category, filename, lineno, file=None, line=None) -> None:
            trouble = re.match(_TROUBLE, str(message))
            if trouble is None:
                show(message, category, filename, lineno, file, line)
            elif trouble[1] == "reading":
                unreadable.append(message)

        warnings.showwarning = note
        try:
            yield
        finally:
            if unreadable:
                for path in folder.iterdir():
                    with suppress(OSError):
                        path.unlink()
