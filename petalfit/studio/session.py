"""One browser: its pages, and what happens to them, one thing after the other."""

from __future__ import annotations

import contextlib
import logging
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import viser

from petalfit.compilation import use_folder
from petalfit.flowers import FlowerError
from petalfit.observations import TargetError
from petalfit.studio.scenery import Scenery
from petalfit.studio.uploads import bound_uploads
from petalfit.studio.work import CalledOff, Work, Workshop

log = logging.getLogger("petalfit.studio")


class Session:
    """What one browser has; nothing of it is shared with another.

    Attributes:
        gui: Its controls.
        scenery: Its scene.
        folder: Of compiled programs, which all browsers share; None for none.
        waiting: Why fits may take their time, as a bracket behind what they are at; or nothing.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        workshop: Workshop,
        folder: Path | None,
        waiting: str,
    ) -> None:
        self._client, self._workshop = client, workshop
        self.folder, self.waiting = folder, waiting
        self._lock = threading.RLock()
        self._work: Work | None = None
        self._closed = False
        self.gui = client.gui
        self.scenery = Scenery(client)
        bound_uploads(client, self.complain)

    @property
    def busy(self) -> bool:
        """Whether a fit waits or runs."""
        return self._work is not None and self._work.running

    def close(self) -> None:
        """The browser has gone: nobody waits for its fit any more."""
        self._closed = True
        self.forget()

    def call_off(self) -> None:
        """Ends the fit, if there is one, which then says so."""
        if self._work is not None:
            self._work.call_off()

    def forget(self) -> None:
        """Ends the fit, if there is one, of which nobody wants to hear any more."""
        self.call_off()
        self._work = None

    def wants(self, work: Work) -> bool:
        """Whether that is the work of which the page tells."""
        return self._work is work

    def complain(self, sentence: str) -> None:
        """Says what was wrong, where it cannot be missed."""
        if not self._closed:
            self._client.add_notification(
                "That did not work", sentence, color="red", auto_close_seconds=20
            )

    def download(self, name: str, write: Callable[[Path], None]) -> None:
        """Gives the browser what a function writes into a file of that name."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            write(path)
            self._client.send_file_download(name, path.read_bytes(), save_immediately=True)

    def compiled(self) -> contextlib.AbstractContextManager[None]:
        """While the block runs, compiled programs are at hand."""
        return use_folder(self.folder)

    @contextlib.contextmanager
    def turn(self) -> Iterator[None]:
        """One thing at a time, with compiled programs at hand; what goes wrong is said on the page.

        Raises:
            CalledOff: The browser has gone.
        """
        with self._lock, self.compiled():
            if self._closed:
                raise CalledOff
            try:
                yield
            except ValueError as error:
                if not isinstance(error, TargetError | FlowerError):
                    log.exception("a wrong value")
                self.complain(str(error))
            except CalledOff:
                raise
            except Exception as error:
                log.exception("an error of petalfit's")
                self.complain(f"petalfit failed ({type(error).__name__}: {error}).")

    def reacting(self, react: Callable[[Any], None]) -> Callable[[Any], None]:
        """A reaction to an event that takes its turn."""

        def reacted(event: Any) -> None:
            with contextlib.suppress(CalledOff), self.turn():
                react(event)

        return reacted

    def latest(self, react: Callable[[], None]) -> Callable[[Any], None]:
        """The same, but of events that come faster than they are answered only the last one is."""
        waiting = [0]

        def reacted(_: Any) -> None:
            waiting[0] += 1
            mine = waiting[0]
            with contextlib.suppress(CalledOff), self.turn():
                if mine == waiting[0]:
                    react()

        return reacted

    def begin(self, do: Callable[[Work], None]) -> None:
        """Starts a fit in the background; one at a time."""
        self._work = Work()
        self._workshop.begin(self._work, do)
