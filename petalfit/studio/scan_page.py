"""The page of a scanned flower: its petals appear one after the other, and each shows its parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import viser
from jaxtyping import Float, Int

from petalfit.components import models
from petalfit.fitting import FOR_SCANS, LOSSES, FlowerResult, family_of, fit_flower
from petalfit.fitting.flower import MOST_PETALS, SEEN
from petalfit.fitting.solver.observer import watching_petals
from petalfit.flowers import Flower
from petalfit.observations import PointCloud, TargetError
from petalfit.report.colour import IGNORED, of_petal
from petalfit.results import FitRecord
from petalfit.studio import words
from petalfit.studio.session import Session
from petalfit.studio.uploads import read_upload
from petalfit.studio.work import Work
from petalfit.synthetic import FLOWERS, scan

_IN_VIEW = 20_000  # the most points drawn
_RESOLUTION = (65, 65)  # that of the fit itself, whose program is compiled already
_ALL = "all petals"
_PALE = 0.25  # opacity of the petals that are not chosen
_SMALL = 0.003  # size of points, beside which the petals can be seen
CASES = {f"{case.name}: {case.about}": case for case in FLOWERS}
_FILES = {
    "flower.json": "All that is known of the flower; open it here again, or with pf.FlowerResult.load",
    "flower.glb": "The petals in the scan's frame as glTF, each with its name",
    "petals.csv": "What is measured of each petal, a row a petal",
    "report.html": "One page with tables and pictures, which needs no network",
}


class ScanPage:
    """The controls of the page, the scan, and the flower that was found in it."""

    def __init__(self, session: Session, grow: Callable[[Flower], None]) -> None:
        """Adds the controls; `grow` takes the flower to the page on which it grows."""
        self._session, self._scenery, self._take_along = session, session.scenery, grow
        self._cloud: PointCloud | None = None
        self._result: FlowerResult | None = None
        self._seen = 0  # petals that have been drawn during a fit
        gui = session.gui
        self.place = gui.add_folder(None)
        with self.place:
            gui.add_html(
                words.soft("Open a scan of a whole flower: every petal is found and fitted.")
            )
            self._upload = gui.add_upload_button(
                "Open a scan", icon=viser.Icon.UPLOAD,
                hint="A cloud or mesh of one flower in any position and unit, or an earlier flower.json",
            )  # fmt: skip
            self._case = gui.add_dropdown("Scan", [*CASES])
            self._about = gui.add_html("")
            with gui.add_folder("Search"):
                self._kind = gui.add_dropdown(
                    "Model", [*_anywhere()], initial_value=FOR_SCANS.__name__
                )
                self._petals = gui.add_number(
                    "Petals", 0, min=0, max=MOST_PETALS, step=1,
                    hint="The number that you see; 0 to find it",
                )  # fmt: skip
                self._loss = gui.add_dropdown("Loss", [*LOSSES], initial_value="robust")
                self._go = gui.add_button(
                    "Find the petals", color="teal", icon=viser.Icon.PLAYER_PLAY
                )
                self._stop = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)
                self._state = gui.add_html("")
            with gui.add_folder("Result", visible=False) as self._found:
                self._verdict = gui.add_html("")
                self._chosen = gui.add_dropdown(
                    "Show", [_ALL], hint="Or click on a petal in the scene"
                )
                self._table = gui.add_html("")
                self._grow = gui.add_button(
                    "Grow it", icon=viser.Icon.PLANT_2,
                    hint="Takes the flower to the page Flower, where every number can be changed",
                )  # fmt: skip
                with gui.add_folder("Download", expand_by_default=True):
                    files = {
                        name: gui.add_button(name, icon=viser.Icon.DOWNLOAD, hint=hint)
                        for name, hint in _FILES.items()
                    }
            with gui.add_folder("View"):
                self._show_petals = gui.add_checkbox("petals", True)
                self._show_points = gui.add_checkbox("points", True)
        self._connect(files)

    def _connect(self, files: dict[str, Any]) -> None:
        """Connects each control to its action."""
        reacting = self._session.reacting
        self._upload.on_upload(reacting(self._uploaded))
        self._case.on_update(reacting(lambda _: self._open_case()))
        self._go.on_click(reacting(lambda _: self._fit()))
        self._stop.on_click(lambda _: self._cancel())
        self._chosen.on_update(reacting(lambda _: self._choose()))
        self._grow.on_click(reacting(lambda _: self._send()))
        for box in (self._show_petals, self._show_points):
            box.on_update(self._session.latest(self._draw))
        for name, button in files.items():
            button.on_click(reacting(lambda _, name=name: self._download(name)))

    def open(self) -> None:
        """Shows the current scan, or makes the first one."""
        self._scenery.clear()
        if self._cloud is None:
            self._open_case()
        else:
            self._draw(look=True)

    def leave(self) -> None:
        """Ends the fit when another page is shown, because it would draw into that page."""
        self._session.forget()
        self._at_rest()

    # The scan.

    def _open_case(self) -> None:
        self._state.content = words.progress("growing the flower, and scanning it", [])
        self._take(scan(CASES[self._case.value]).cloud, "")

    def _uploaded(self, event: Any) -> None:
        file = event.target.value
        read = read_upload(file.name, file.content, SEEN)
        if isinstance(read, FlowerResult):
            self._take(read.target, f"the flower of {file.name}")
            self._present(read)
        elif isinstance(read, PointCloud):
            self._take(read, f"{file.name}, {read.described}")
        else:
            raise TargetError(
                f"{file.name} shows a single petal or its outline; open it on the page Petal. A flower "
                "is a cloud or a mesh."
            )

    def _take(self, cloud: PointCloud, about: str) -> None:
        """Sets a new scan."""
        self._session.forget()
        self._at_rest()
        self._cloud, self._result = cloud, None
        self._about.content, self._state.content = words.text(about), ""
        self._found.visible = False
        self._scenery.clear()
        self._draw(look=True)

    # The fit.

    def _fit(self) -> None:
        if self._session.busy and self._result is None:
            raise TargetError("a fit is running; wait for it, or cancel it first.")
        cloud = self._cloud
        assert cloud is not None, "a page opens with a scan"
        options = {
            "model": models()[self._kind.value],
            "petals": int(self._petals.value) or None,
            "loss": self._loss.value,
        }
        self._result, self._seen, self._found.visible = None, 0, False
        self._stop.visible, self._go.disabled = True, True
        self._state.content = words.progress("waiting for a core", [])
        self._scenery.clear()
        self._draw(look=True)
        self._session.begin(lambda work: self._run(work, cloud, options))

    def _run(self, work: Work, cloud: PointCloud, options: dict[str, Any]) -> None:
        """Runs the fit in a thread of its own, and shows each petal as soon as it has been fitted."""
        session = self._session

        def tell(text: str) -> None:
            work.check()
            with session.turn():
                work.check()
                self._state.content = words.progress(text + session.waiting, [])

        def look(petal: FitRecord) -> None:
            work.check()
            with session.turn():
                work.check()
                self._draw_petal(self._seen, self._vertices(petal), lambda _: None)
                self._seen += 1

        def fit() -> FlowerResult:
            with watching_petals(look):
                return fit_flower(cloud, throw=False, progress=tell, **options)

        outcome = session.outcome_of(work, fit, self._present, self._called_off)
        with session.turn():
            if not session.wants(work):
                return
            self._at_rest()
            self._state.content = ""
            outcome()

    def _at_rest(self) -> None:
        self._stop.visible, self._go.disabled = False, False

    def _cancel(self) -> None:
        """Cancels the fit at once, without waiting for the turn of another reaction."""
        self._at_rest()
        # The end of the fit, which may come at once, has the last word.
        self._state.content = words.soft("cancelling; a step that has begun ends first")
        self._session.call_off()

    def _called_off(self) -> None:
        self._state.content = words.soft("cancelled")

    def _present(self, result: FlowerResult) -> None:
        """Shows the flower that was found."""
        self._result = result
        self._verdict.content = words.flower(result)
        self._chosen.options = [_ALL, *result.names]
        self._chosen.value = _ALL
        self._found.visible = True
        self._scenery.clear()
        self._draw(look=True)

    def _choose(self) -> None:
        """Shows the parameters of the chosen petal, and lets the others fade."""
        result = self._result
        if result is None:
            return
        petal = self._petal_chosen(result)
        self._table.content = "" if petal is None else words.table(result.petals[petal])
        self._draw()

    def _petal_chosen(self, result: FlowerResult) -> int | None:
        chosen = self._chosen.value
        return None if chosen == _ALL else result.names.index(chosen)

    def _send(self) -> None:
        assert self._result is not None, "the button shows with a result"
        self._take_along(self._result.flower())

    # The drawing: in the flower's frame, upright, as soon as it is known.

    def _placed(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        result = self._result
        return points if result is None else result.axis.into(points)

    def _vertices(
        self, petal: FitRecord
    ) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
        mesh = petal.mesh(_RESOLUTION)
        return self._placed(np.asarray(mesh.vertices)), np.asarray(mesh.faces)

    def _draw(self, look: bool = False) -> None:
        """Draws the points and the petals; `look` moves the viewer to a new place."""
        cloud, result = self._cloud, self._result
        if cloud is None:
            return
        some = np.random.default_rng(0).permutation(len(cloud))[:_IN_VIEW]
        points = self._placed(cloud.points[some])
        if look:
            self._scenery.look_at(points)
        colours = np.tile(IGNORED, (len(points), 1))
        if result is not None:
            labels, chosen = result.labels[some], self._petal_chosen(result)
            for petal, fit in enumerate(result.petals):
                pale = chosen not in (None, petal)
                if not pale:
                    colours[labels == petal] = of_petal(petal)
                self._draw_petal(petal, self._vertices(fit), self._clicked(petal), pale)
        self._scenery.points(points, colours, self._show_points.value, _SMALL)

    def _draw_petal(
        self,
        number: int,
        sheet: tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]],
        clicked: Callable[[Any], None],
        pale: bool = False,
    ) -> None:
        opacity = _PALE if pale else None
        shown = self._show_petals.value
        self._scenery.sheet(
            f"petal_{number + 1}", *sheet, of_petal(number), opacity, shown, clicked
        )

    def _clicked(self, petal: int) -> Callable[[Any], None]:
        """What happens at a click on a petal: it is chosen, or no longer if it was."""

        def choose(_: Any) -> None:
            if self._result is not None:
                name = self._result.names[petal]
                self._chosen.value = _ALL if self._chosen.value == name else name

        return self._session.reacting(choose)

    def _download(self, name: str) -> None:
        result = self._result
        assert result is not None, "the buttons show with a result"

        def table(path: Path) -> None:
            path.write_text(result.table(), encoding="utf-8")

        write: dict[str, Callable[[Path], None]] = {
            "flower.json": result.save,
            "flower.glb": result.export,
            "petals.csv": table,
            "report.html": result.report,
        }
        self._session.download(name, write[name])


def _anywhere() -> list[str]:
    """The models that are fitted in any position and unit, as petals of a flower are."""
    return [name for name, kind in models().items() if "similarity" in family_of(kind).poses]
