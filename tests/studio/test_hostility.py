"""What a page of another origin, or a client that is no page, can make the studio do: nothing."""

import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
import zstandard
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from petalfit.studio.guard import refusal
from petalfit.studio.uploads import LARGEST

# Seconds after which something hangs, and is not merely slow on a busy machine.
A_WHILE = 100


@pytest.fixture(scope="module")
def address(url: str) -> str:
    """Host and port of a running studio."""
    return url.removeprefix("http://")


class Client:
    """A client that speaks to the studio as its page does."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.uuids: dict[str, str] = {}

    def until(self, found: Any) -> dict[str, Any]:
        """The first message from now on of which `found` is true."""
        while True:
            raw = self._connection.recv(timeout=A_WHILE)
            assert isinstance(raw, bytes)
            length = int.from_bytes(raw[8:16], "little")
            inner = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + length])
            for message in msgspec.msgpack.decode(inner)["messages"]:
                label = message.get("props", {}).get("label")
                if label is not None and "uuid" in message:
                    self.uuids[label] = message["uuid"]
                if found(message):
                    return message

    def send(self, kind: str, **members: Any) -> None:
        self._connection.send(msgspec.msgpack.encode({"type": kind} | members))

    def complaint(self) -> str:
        shown = self.until(lambda message: message["type"].startswith("Notification"))
        return msgspec.json.encode(shown).decode()


@pytest.fixture
def client(address) -> Iterator[Client]:
    protocols = [f"viser-v{viser.__version__}"]
    with connect(f"ws://{address}", subprotocols=protocols, max_size=None) as connection:
        made = Client(connection)
        # The studio greets a browser once it knows its camera.
        made.send(
            "ViewerCameraMessage", wxyz=[1.0, 0.0, 0.0, 0.0], position=[1.0, 1.0, 1.0], fov=1.0,
            near=0.1, far=10.0, image_height=100, image_width=100, look_at=[0.0, 0.0, 0.0],
            up_direction=[0.0, 0.0, 1.0],
        )  # fmt: skip
        made.until(lambda _: "dark" in made.uuids)
        yield made


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:1", "http://localhost:3000", "null"]
)
def test_a_page_of_another_origin_cannot_connect(address, origin):
    with pytest.raises(InvalidStatus, match="403"), connect(f"ws://{address}", origin=origin):
        pass


def test_a_page_under_another_name_gets_nothing(address):
    """DNS rebinding: the name of a hostile page leads to this computer."""
    for name in ("evil.example", "evil.example:80", "127.0.0.1.evil.example", ""):
        request = urllib.request.Request(f"http://{address}", headers={"Host": name})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(request, timeout=A_WHILE)


def test_its_own_page_connects_and_cannot_be_framed(address):
    with urllib.request.urlopen(f"http://{address}", timeout=A_WHILE) as page:
        assert page.headers["X-Frame-Options"] == "DENY"
        assert b"<html" in page.read()
    with connect(f"ws://{address}", origin=f"http://{address}", max_size=None):
        pass


@pytest.mark.parametrize(
    ("hosts", "origins", "refused"),
    [
        (["localhost:9000"], ["http://localhost:9000"], False),  # a tunnel
        (["[::1]:8090"], ["http://[::1]:8090"], False),
        (["localhost:8090"], [], False),  # no browser
        (["localhost:8090", "localhost:8090"], [], True),
        (["localhost:8090"], ["http://127.0.0.1:8090"], True),
        (["localhost:8090"], ["http://localhost:8090", "http://localhost:8090"], True),
        (["[::1"], ["http://[::1"], True),
        (["localhost@evil.example"], [], True),
        ([], [], True),
    ],
)
def test_who_is_refused(hosts, origins, refused):
    assert bool(refusal(hosts, origins)) == refused


@pytest.mark.parametrize(
    ("label", "updates"),
    [
        ("Seed", {"value": "a text"}),
        ("Seed", {"value": float("nan")}),
        ("Seed", {"value": -1}),
        ("Seed", {"value": 1, "update_cb": []}),
        ("Seed", {"update_timestamp": 0}),
        ("Seed", {}),
        ("Pose", {"value": "upside down"}),
        ("Pose", {"value": None}),
        ("dark", {"value": "yes"}),
        ("On the petal", {"value": [1.0]}),
        ("On the petal", {"value": [1.0, "2"]}),
        ("Open a file", {"value": "x"}),
        ("Fit", {"value": 1}),
    ],
)
def test_a_control_takes_no_value_that_it_cannot_have(client, label, updates):
    client.send("GuiUpdateMessage", uuid=client.uuids[label], updates=updates)
    assert "nothing has changed" in client.complaint()


@pytest.mark.parametrize(
    ("size", "parts", "said"),
    [
        (LARGEST + 1, 2, "this page takes 100 MB"),
        (-1, 1, "That upload is damaged"),
        (10, 10**9, "That upload is damaged"),
    ],
)
def test_an_upload_is_bounded_when_it_is_announced(client, size, parts, said):
    client.send(
        "FileTransferStartUpload", source_component_uuid=client.uuids["Open a file"],
        transfer_uuid="t", filename="<img src=x>.ply", mime_type="", part_count=parts,
        size_bytes=size,
    )  # fmt: skip
    assert said in client.complaint()


def test_an_upload_is_bounded_while_it_arrives(client):
    client.send(
        "FileTransferStartUpload", source_component_uuid=client.uuids["Open a file"],
        transfer_uuid="t", filename="a.ply", mime_type="", part_count=2, size_bytes=10,
    )  # fmt: skip
    part = {"source_component_uuid": client.uuids["Open a file"], "transfer_uuid": "t"}
    client.send("FileTransferPart", **part, part_index=0, content=bytes(5))
    client.send("FileTransferPart", **part, part_index=1, content=bytes(6))
    assert "a.ply is not as long as it was said to be" in client.complaint()


def test_the_name_of_a_file_is_text(client):
    client.send(
        "FileTransferStartUpload", source_component_uuid=client.uuids["Open a file"],
        transfer_uuid="t", filename="<img src=x onerror=alert(1)>.xyz", mime_type="", part_count=1,
        size_bytes=1000,
    )  # fmt: skip
    lines = [f"{k % 7} {k % 5} {k % 3}\n" for k in range(166)]
    content = "".join(lines).encode().ljust(1000, b"\n")
    part = {"source_component_uuid": client.uuids["Open a file"], "transfer_uuid": "t"}
    client.send("FileTransferPart", **part, part_index=0, content=content)
    client.until(lambda message: "&lt;img src=x onerror" in repr(message))
