"""The cache of compiled programs: a second `petalfit fit` need not compile again.

The programs lie in a folder of the user's cache, with one subfolder for each kind of processor. When all
of them together exceed `LIMIT`, the oldest are removed. The environment variable PETALFIT_CACHE names
another folder; if it is empty, the cache is off. A folder that cannot be used only costs time, and one
that others may write to is not used, because loading a program can run any code.
"""

import functools
import hashlib
import os
import platform
import re
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

VARIABLE = "PETALFIT_CACHE"
LIMIT = 256_000_000  # one size of cloud needs about 3 MB


@contextmanager
def compilation_cache() -> Iterator[bool]:
    """Makes a block of code store its compiled programs in the cache and load them from it.

    Yields:
        Whether the cache may contain programs already; if not, the user has to wait for compilation.
    """
    from petalfit.compilation import ExecutableStore, use_store

    folder = _usable_folder()
    if folder is None:
        yield False
        return
    with use_store(ExecutableStore(folder)):
        yield any(folder.iterdir())


def folder_in_common() -> Path | None:
    """The folder where other processes find this one's programs: its store, else the cache, else None."""
    from petalfit.compilation.store import current_store

    store = current_store()
    return _usable_folder() if store is None else store.folder


def _usable_folder() -> Path | None:
    """The folder for this processor, created if necessary; None for no cache."""
    root = os.environ.get(VARIABLE)
    if root == "":
        return None
    try:
        root = user_cache() if root is None else Path(root).absolute()
        folder = root / f"programs-{_processor()}"
        # Only the user may write there, because loading a program can run any code.
        _make_private(folder)
        _prune(root)
    except (OSError, RuntimeError):  # RuntimeError: the user has no home
        return None
    reason = open_to_others(folder)
    if reason:
        _say_once(
            f"{reason}, so compiled programs are neither read nor kept, which costs time; let nobody "
            f"else write there, or set {VARIABLE} to another folder."
        )
        return None
    return folder if os.access(folder, os.R_OK | os.W_OK | os.X_OK) else None


def _make_private(folder: Path) -> None:
    """Makes a folder, and those above it that are missing, for the user alone."""
    for place in (*reversed(folder.parents), folder):
        # Only this sets the mode of every folder: with `parents`, mkdir gives those above the usual one.
        if not place.is_dir():
            place.mkdir(mode=0o700, exist_ok=True)


def open_to_others(folder: Path) -> str:
    """Why somebody else could put programs into a folder, as a part of a sentence; "" if nobody can.

    Nobody but the user and the administrator may own it or a folder above it, or write there; a folder
    such as /tmp, in which all may make files but only move their own, is no danger to those in it.
    """
    if not hasattr(os, "geteuid"):  # Windows, where a user's folders are the user's own
        return ""
    real = Path(os.path.realpath(folder))
    for place in (real, *real.parents):
        status = place.stat()
        if status.st_uid not in (os.geteuid(), 0):
            return f"{place} belongs to somebody else"
        shared = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if shared and (place == real or not status.st_mode & stat.S_ISVTX):
            return f"others may write to {place}"
    return ""


@functools.cache
def _say_once(sentence: str) -> None:
    print(f"petalfit: {sentence}", file=sys.stderr)


def user_cache() -> Path:
    """The folder in which this platform keeps caches of petalfit."""
    match sys.platform:
        case "win32":
            base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        case "darwin":
            base = Path.home() / "Library" / "Caches"
        case _:
            base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "petalfit"


def _processor() -> str:
    """Twelve digits that identify the instructions that a compiled program may use."""
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
    """Removes the oldest files, down to half of the limit, if the limit is exceeded."""
    status = {path: path.stat() for path in root.glob("programs-*/*")}
    size = sum(entry.st_size for entry in status.values())
    if size <= LIMIT:
        return
    for path in sorted(status, key=lambda path: status[path].st_mtime):
        path.unlink(missing_ok=True)
        size -= status[path].st_size
        if size <= LIMIT // 2:
            break
