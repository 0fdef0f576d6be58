"""Writing a file completely or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a path to write to, which replaces `path` when the block ends without an error.

    The temporary path lies in the same folder, so that the last step is a rename within one file
    system, and has the same suffix, because some writers look at the suffix. If the block
    raises anything, `KeyboardInterrupt` included, the temporary file is removed and the previous
    content of `path` is kept.

    Args:
        path: The path of the file to write. A symbolic link is followed, not replaced.

    Yields:
        The temporary path, at which no file exists yet.

    Raises:
        OSError: `path` exists and is not a regular file, or the folder cannot be written to.
    """
    # Without realpath the rename would replace the link by a file.
    final = Path(os.path.realpath(path))
    # A rename onto /dev/null, as root, would replace the device.
    if final.exists() and not final.is_file():
        raise OSError(f"{path} exists and is not a regular file; choose another name.")
    # tempfile.mkstemp is not used, because it makes files that only their owner may read.
    temporary = final.with_name(f".petalfit-{secrets.token_hex(8)}{final.suffix}")
    try:
        yield temporary
        os.replace(temporary, final)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
