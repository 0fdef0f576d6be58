"""The session of one browser, which handles its events one after the other."""

from __future__ import annotations

import contextlib
import logging
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import viser

from petalfit.compilation import use_folder
from petalfit.flowers import FlowerError
from petalfit.observations import TargetError
from petalfit.studio.scenery import Scenery
from petalfit.studio.uploads import bound_uploads
from petalfit.studio.values import check_values
from petalfit.studio.work import CalledOff, Work, Workshop

Result = TypeVar("Result")
log = logging.getLogger("petalfit.studio")


class Session:
    """The state of one browser, none of which is shared with another browser.

    Attributes:
        gui: The controls of the browser.
        scenery: The 3-D scene of the browser.
        folder: The folder of compiled programs, which all browsers share, or None.
        waiting: A text in brackets, appended to the progress of a fit, on why it may take long; or "".
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
        check_values(client, self.complain)

    @property
    def busy(self) -> bool:
        """Whether a fit is waiting or running."""
        return self._work is not None and self._work.running

    def close(self) -> None:
        """Ends the session, and its fit, after the browser has gone."""
        self._closed = True
        self.forget()

    def call_off(self) -> None:
        """Cancels the fit, if there is one; the page will report it."""
        if self._work is not None:
            self._work.call_off()

    def forget(self) -> None:
        """Cancels the fit, if there is one; the page will not report it."""
        self.call_off()
        self._work = None

    def wants(self, work: Work) -> bool:
        """Whether the page still reports this work, and not a later one."""
        return self._work is work

    def complain(self, sentence: str) -> None:
        """Shows an error message as a notification."""
        if not self._closed:
            self._client.add_notification(
                "That did not work", sentence, color="red", auto_close_seconds=20
            )

    def download(self, name: str, write: Callable[[Path], None]) -> None:
        """Sends the browser a file of this name that a function writes."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            write(path)
            self._client.send_file_download(name, path.read_bytes(), save_immediately=True)

    def compiled(self) -> contextlib.AbstractContextManager[None]:
        """Makes a block of code load compiled programs from the folder and save them there."""
        return use_folder(self.folder)

    @contextlib.contextmanager
    def turn(self) -> Iterator[None]:
        """Runs a block while no other one runs, with compiled programs; shows its errors on the page.

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
        """A handler that reacts to an event when it is its turn."""

        def reacted(event: Any) -> None:
            with contextlib.suppress(CalledOff), self.turn():
                react(event)

        return reacted

    def latest(self, react: Callable[[], None]) -> Callable[[Any], None]:
        """A handler that waits for its turn and then reacts only to the latest of the waiting events."""
        waiting = [0]

        def reacted(_: Any) -> None:
            waiting[0] += 1
            mine = waiting[0]
            with contextlib.suppress(CalledOff), self.turn():
                if mine == waiting[0]:
                    react()

        return reacted

    def outcome_of(
        self,
        work: Work,
        fit: Callable[[], Result],
        present: Callable[[Result], None],
        called_off: Callable[[], None],
    ) -> Callable[[], None]:
        """Runs a fit with compiled programs, and returns what the page has to do at its end.

        Args:
            work: The work that the fit belongs to.
            fit: The fit.
            present: What the page does with its result.
            called_off: What the page does if the work was cancelled. An error is raised when it is its
                turn, so that the page shows it.
        """
        try:
            work.check()
            with self.compiled():
                result = fit()
        except CalledOff:
            return called_off
        except Exception as error:
            return _raising(error)
        return lambda: present(result)

    def begin(self, do: Callable[[Work], None]) -> None:
        """Starts a fit in the background, as the only one that the page reports."""
        self._work = Work()
        self._workshop.begin(self._work, do)


def _raising(error: Exception) -> Callable[[], None]:
    def outcome() -> None:
        raise error

    return outcome
