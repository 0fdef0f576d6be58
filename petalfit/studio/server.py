"""The server of the studio: it listens on this computer only, and gives each browser a session."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path

import viser

from petalfit.compilation.cache import folder_in_common
from petalfit.flowers import Flower
from petalfit.studio.flower_page import FlowerPage
from petalfit.studio.guard import own_pages_only
from petalfit.studio.petal_page import PetalPage
from petalfit.studio.scan_page import ScanPage
from petalfit.studio.session import Session
from petalfit.studio.work import Workshop

HOST = "127.0.0.1"
PORT = 8090
_PETAL, _SCAN, _FLOWER = "Petal", "Flower scan", "Flower"
_BRAND = (176, 66, 108)


def _dress(gui: viser.GuiApi, dark: bool) -> None:
    gui.configure_theme(
        control_width="large",
        dark_mode=dark,
        show_logo=False,
        show_share_button=False,
        brand_color=_BRAND,
    )


class Studio:
    """A running server.

    Attributes:
        url: The address of the server, with the requested port or the next free one.
    """

    def __init__(self, port: int = PORT) -> None:
        # viser warns about drawings for a tab that has just been closed; they are not needed.
        warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection")
        self._workshop = Workshop()
        self._folder: Path | None = folder_in_common()
        first = self._folder is None or not any(self._folder.iterdir())
        self._again = " (compiling, which only the first fit needs)" if first else ""
        self._sessions: dict[int, Session] = {}
        # viser prints a banner.
        with contextlib.redirect_stdout(io.StringIO()), own_pages_only():
            self._server = viser.ViserServer(HOST, port, verbose=False)
        _dress(self._server.gui, dark=False)
        self._server.gui.set_panel_label("petalfit studio")
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._take_leave)
        self.url = f"http://{HOST}:{self._server.get_port()}"

    def stop(self) -> None:
        """Ends all fits and stops the server."""
        for session in [*self._sessions.values()]:
            session.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _welcome(self, client: viser.ClientHandle) -> None:
        session = Session(client, self._workshop, self._folder, self._again)
        self._sessions[client.client_id] = session
        Pages(session)

    def _take_leave(self, client: viser.ClientHandle) -> None:
        session = self._sessions.pop(client.client_id, None)
        if session is not None:
            session.close()


class Pages:
    """The pages of a session, of which one is shown, and the controls that all share."""

    def __init__(self, session: Session) -> None:
        gui = session.gui
        choice = gui.add_button_group("Page", (_PETAL, _SCAN, _FLOWER))
        self._flower = FlowerPage(session)
        petal, found = PetalPage(session), ScanPage(session, self._grow)
        self._pages = {_PETAL: petal, _SCAN: found, _FLOWER: self._flower}
        self._shown = _PETAL
        for name, page in self._pages.items():
            page.place.visible = name == _PETAL
        dark = gui.add_checkbox("dark", False)
        choice.on_click(session.reacting(lambda event: self._open(event.target.value)))
        dark.on_update(session.reacting(lambda _: _dress(gui, dark.value)))
        session.reacting(lambda _: petal.open_case())(None)

    def _open(self, name: str) -> None:
        if self._shown == name:
            return
        self._turn_to(name)
        self._pages[name].open()

    def _grow(self, flower: Flower) -> None:
        """Takes a flower that was found in a scan to the page on which it grows."""
        self._turn_to(_FLOWER)
        self._flower.take(flower)

    def _turn_to(self, name: str) -> None:
        self._pages[self._shown].leave()
        self._shown = name
        for each, page in self._pages.items():
            page.place.visible = each == name
