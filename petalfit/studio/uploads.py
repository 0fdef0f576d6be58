"""What a browser sends: bounded while it comes, and then parsed as data."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import numpy as np
import viser
from jaxtyping import Float
from viser import _messages

from petalfit.fitting import FitResult
from petalfit.observations import (
    IMAGE_SUFFIXES,
    Camera,
    PointCloud,
    Silhouette,
    TargetError,
    read_cameras,
)
from petalfit.observations.images import opened_image
from petalfit.observations.photo import read_photo, segment
from petalfit.observations.readers import SUFFIXES

LARGEST = 100_000_000  # bytes, as sent and unpacked
_LARGEST_IMAGE = 40_000_000  # pixels


@dataclasses.dataclass(frozen=True)
class Photo:
    """A photo, and the petal that was cut out of it.

    Attributes:
        picture: Colours from 0 to 1, shape (h, w, 3).
        target: The petal's mask.
    """

    picture: Float[np.ndarray, "h w 3"]
    target: Silhouette

    @classmethod
    def of(cls, image: Float[np.ndarray, "h w c"], place: tuple[float, float] | None) -> Photo:
        """A photo whose petal is at a place, or what stands out most.

        Raises:
            TargetError: Nothing does.
        """
        try:
            mask = segment(image, () if place is None else (place,))
        except TargetError as error:
            # What the message advises is an option of a command; here it is a field of the page.
            text = str(error).replace(
                "with --point x,y", "below, in pixels from the left and the top"
            )
            raise TargetError(text) from None
        return cls(image[..., :3], Silhouette(mask))


Read = PointCloud | Silhouette | Photo | Camera | FitResult


def read_upload(name: str, content: bytes) -> Read:
    """A file as what it holds.

    Args:
        name: As the browser calls it; only its suffix is believed.
        content: All of it.

    Raises:
        TargetError: It is none of what the page can use; the message begins with the name.
    """
    shown = PurePosixPath(name.replace("\\", "/")).name or "the file"
    suffix = Path(shown).suffix.lower()
    if not content:
        raise TargetError(f"{shown} is empty; export or copy it again.")
    if len(content) > LARGEST:
        raise TargetError(too_large(shown, len(content)))
    if suffix == ".gltf":
        raise TargetError(
            f"{shown} names other files, which did not come along; export it as .glb."
        )
    known = (*SUFFIXES, *IMAGE_SUFFIXES, ".json")
    if suffix not in known:
        raise TargetError(
            f"{shown} is of no kind that can be fitted; give a cloud or mesh "
            f"({' '.join(s for s in SUFFIXES if s != '.gltf')}), a mask or photo "
            f"({' '.join(IMAGE_SUFFIXES)}), or a camera or fit (.json)."
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"upload{suffix}"
        path.write_bytes(content)
        try:
            return _read(path)
        except TargetError as error:
            text = str(error).removeprefix(f"{path}: ").replace(str(path), shown)
            text = text if text.startswith(shown) else f"{shown}: {text}"
            raise TargetError(text) from None


def too_large(name: str, size: int) -> str:
    """What is said of a file that is."""
    return (
        f"{name} holds {size / 1e6:.0f} MB; this page takes {LARGEST / 1e6:.0f} MB. Thin the cloud or "
        "decimate the mesh, or use `petalfit fit` on the command line."
    )


def _read(path: Path) -> Read:
    if path.suffix == ".json":
        return _read_json(path)
    if path.suffix in IMAGE_SUFFIXES:
        return _read_image(path)
    if path.suffix == ".npz":
        _check_unpacked(path)
    return PointCloud.load(path)


def _read_json(path: Path) -> FitResult | Camera:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise TargetError(f"it is no JSON ({error}).") from None
    if isinstance(content, dict) and "format" in content:
        return FitResult.load(path)
    camera = read_cameras(path)
    if not isinstance(camera, Camera):
        raise TargetError("it has cameras of many images; this page takes the camera of one.")
    return camera


def _read_image(path: Path) -> Silhouette | Photo:
    with opened_image(path) as image:
        pixels = image.width * image.height
    if pixels > _LARGEST_IMAGE:
        raise TargetError(
            f"it has {pixels / 1e6:.0f} million pixels; this page takes "
            f"{_LARGEST_IMAGE / 1e6:.0f} million. Make it smaller."
        )
    try:
        return Silhouette.load(path)
    except TargetError:
        return Photo.of(read_photo(path), None)


def _check_unpacked(path: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
    except (OSError, zipfile.BadZipFile):
        return  # which its reader says better
    if size > LARGEST:
        raise TargetError(
            f"it unpacks to {size / 1e6:.0f} MB; this page takes {LARGEST / 1e6:.0f} MB."
        )


def bound_uploads(client: viser.ClientHandle, refuse: Callable[[str], None]) -> None:
    """Drops what a browser sends beyond `LARGEST`, as it announces it or as it comes.

    viser has no bound of its own, and keeps parts in memory until the last one is there.

    Args:
        client: The browser.
        refuse: Called with a sentence for whoever sent it.
    """
    gui = client.gui
    interface, uploads = gui._websock_interface, gui._current_file_upload_states
    start, part = gui._handle_file_transfer_start, gui._handle_file_transfer_part

    def bounded_start(sender: int, message: _messages.FileTransferStartUpload) -> None:
        if message.size_bytes <= LARGEST:
            start(sender, message)  # pyright: ignore[reportArgumentType]
            return
        # So that the page stops waiting for it.
        interface.queue_message(
            _messages.FileTransferPartAck(
                source_component_uuid=message.source_component_uuid,
                transfer_uuid=message.transfer_uuid,
                transferred_bytes=message.size_bytes,
                total_bytes=message.size_bytes,
            )
        )
        refuse(too_large(message.filename, message.size_bytes))

    def bounded_part(sender: int, message: _messages.FileTransferPart) -> None:
        state = uploads.get(message.transfer_uuid)
        if state is None:
            return
        if state["transferred_bytes"] + len(message.content) > state["total_bytes"]:
            uploads.pop(message.transfer_uuid)
            refuse(f"{state['filename']} is longer than it was said to be; send it again.")
            return
        part(sender, message)  # pyright: ignore[reportArgumentType]

    interface.unregister_handler(_messages.FileTransferStartUpload, start)
    interface.register_handler(_messages.FileTransferStartUpload, bounded_start)
    interface.unregister_handler(_messages.FileTransferPart, part)
    interface.register_handler(_messages.FileTransferPart, bounded_part)
