"""The memory that is left, so that what does not fit is refused before it is read."""

from pathlib import Path

import psutil

from petalfit.observations.errors import TargetError

# Limits of a container, of which psutil knows nothing: what it may use, and what it uses.
_LIMITS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
    ),
)


def available_memory() -> int:
    """The number of bytes that this process can still take without swapping."""
    left = psutil.virtual_memory().available
    for limit, used in _LIMITS:
        try:
            left = min(left, int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):  # There is no such file, or the limit is "max".
            continue
    return max(left, 0)


def check_memory(needed: int | float) -> None:
    """Raises an error if there is not enough memory.

    Args:
        needed: The number of bytes that reading a file takes.

    Raises:
        TargetError: There are fewer bytes left.
    """
    left = available_memory()
    if needed > left:
        raise TargetError(
            f"takes {needed / 1e9:.3g} GB of memory to read, and {left / 1e9:.3g} GB are available; thin "
            "the cloud or decimate the mesh first."
        )
