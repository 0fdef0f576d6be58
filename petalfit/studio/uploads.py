"""Uploads from a browser: their size is limited while they arrive, then they are parsed as data."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import numpy as np
import viser
from jaxtyping import Float, UInt8
from viser import _messages

from petalfit.fitting import FitResult, FlowerResult
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
from petalfit.observations.readers import DEFAULT_SAMPLES, SUFFIXES
from petalfit.results.flower_record import FORMAT as FLOWER_FORMAT

LARGEST = 100_000_000  # bytes of an upload, both as sent and unpacked
_LARGEST_IMAGE = 40_000_000  # pixels


@dataclasses.dataclass(frozen=True)
class Photo:
    """A photo, and the mask of the petal in it.

    Attributes:
        picture: The colours from 0 to 1, shape (h, w, 3).
        target: The mask of the petal.
    """

    picture: Float[np.ndarray, "h w 3"]
    target: Silhouette

    @classmethod
    def of(
        cls,
        image: UInt8[np.ndarray, "h w c"] | Float[np.ndarray, "h w c"],
        place: tuple[float, float] | None,
    ) -> Photo:
        """Segments a photo; the petal is the object at a place (x, y), or the one that stands out most.

        Raises:
            TargetError: No object stands out.
        """
        try:
            mask = segment(image, () if place is None else (place,))
        except TargetError as error:
            # The message recommends an option of a command; on the page this is a field.
            text = str(error).replace(
                "with --point x,y", "below, in pixels from the left and the top"
            )
            raise TargetError(text) from None
        colours = image[..., :3] / 255 if image.dtype == np.uint8 else image[..., :3]
        return cls(colours, Silhouette(mask))


Read = PointCloud | Silhouette | Photo | Camera | FitResult | FlowerResult


def read_upload(name: str, content: bytes, samples: int = DEFAULT_SAMPLES) -> Read:
    """Reads an uploaded file of any supported kind.

    Args:
        name: The name of the file in the browser; only its suffix is used.
        content: The complete content of the file.
        samples: The number of points that are drawn from a mesh.

    Raises:
        TargetError: The page cannot use the file; the message begins with the name.
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
            return _read(path, samples)
        except TargetError as error:
            text = str(error).removeprefix(f"{path}: ").replace(str(path), shown)
            text = text if text.startswith(shown) else f"{shown}: {text}"
            raise TargetError(text) from None


def too_large(name: str, size: int) -> str:
    """The error message for a file that is too large."""
    return (
        f"{name} holds {size / 1e6:.0f} MB; this page takes {LARGEST / 1e6:.0f} MB. Thin the cloud or "
        "decimate the mesh, or use `petalfit fit` on the command line."
    )


def _read(path: Path, samples: int) -> Read:
    if path.suffix == ".json":
        return _read_json(path)
    if path.suffix in IMAGE_SUFFIXES:
        return _read_image(path)
    if path.suffix == ".npz":
        _check_unpacked(path)
    return PointCloud.load(path, n=samples)


def _read_json(path: Path) -> FitResult | FlowerResult | Camera:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise TargetError(f"it is no JSON ({error}).") from None
    if isinstance(content, dict) and content.get("format") == FLOWER_FORMAT:
        return FlowerResult.load(path)
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
        return  # the reader of the file gives a better error
    if size > LARGEST:
        raise TargetError(
            f"it unpacks to {size / 1e6:.0f} MB; this page takes {LARGEST / 1e6:.0f} MB."
        )


def bound_uploads(client: viser.ClientHandle, refuse: Callable[[str], None]) -> None:
    """Refuses uploads of more than `LARGEST` bytes, when they are announced or while they arrive.

    viser itself has no limit, and keeps all parts in memory until the last one has arrived. A browser
    sends one file at a time, so that a new one takes the place of one that has not arrived.

    Args:
        client: The browser.
        refuse: A function that is called with an error message for the user.
    """
    gui = client.gui
    interface, uploads = gui._websock_interface, gui._current_file_upload_states
    start, part = gui._handle_file_transfer_start, gui._handle_file_transfer_part

    def bounded_start(sender: int, message: _messages.FileTransferStartUpload) -> None:
        size, parts = message.size_bytes, message.part_count
        # No part is empty, so there are not more parts than bytes.
        if type(size) is not int or type(parts) is not int or not 0 <= parts <= size:
            refuse("That upload is damaged; send the file again.")
            return
        if size <= LARGEST:
            uploads.clear()
            start(sender, message)  # pyright: ignore[reportArgumentType]
            return
        # This acknowledgement makes the page stop waiting for the upload.
        interface.queue_message(
            _messages.FileTransferPartAck(
                source_component_uuid=message.source_component_uuid,
                transfer_uuid=message.transfer_uuid,
                transferred_bytes=size,
                total_bytes=size,
            )
        )
        refuse(too_large(str(message.filename), size))

    def bounded_part(sender: int, message: _messages.FileTransferPart) -> None:
        state = uploads.get(message.transfer_uuid)
        if state is None:
            return
        left = state["total_bytes"] - state["transferred_bytes"]
        if not isinstance(message.content, bytes) or not 0 < len(message.content) <= left:
            uploads.pop(message.transfer_uuid)
            refuse(f"{state['filename']} is not as long as it was said to be; send it again.")
            return
        part(sender, message)  # pyright: ignore[reportArgumentType]

    interface.unregister_handler(_messages.FileTransferStartUpload, start)
    interface.register_handler(_messages.FileTransferStartUpload, bounded_start)
    interface.unregister_handler(_messages.FileTransferPart, part)
    interface.register_handler(_messages.FileTransferPart, bounded_part)
