"""The page of one petal: opening a target, watching its fit, sliders and downloads."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np

from petalfit.components import Posed, models, parameters
from petalfit.export.mesh import export_glb
from petalfit.fitting import (
    DEFAULT,
    FOR_SCANS,
    FitResult,
    FlowerResult,
    family_of,
    fit_petal,
    tip_of,
)
from petalfit.fitting.solver.observer import Glimpse, looking_on
from petalfit.observations import AbstractObservation, Camera, Silhouette, TargetError
from petalfit.report import write_report
from petalfit.report.colour import diverging
from petalfit.report.scene import distance_limit
from petalfit.results import Start
from petalfit.studio import words
from petalfit.studio.drawn import AbstractDrawn, DrawnMask, drawn
from petalfit.studio.petal_controls import CASES, FITTED, PetalControls
from petalfit.studio.session import Session
from petalfit.studio.sliders import add_slider
from petalfit.studio.uploads import Photo, read_upload
from petalfit.studio.work import Work
from petalfit.surfaces import AbstractSurface, Pose, in_doubles, value_at, with_value
from petalfit.synthetic import make, make_masks

_RESOLUTION = (65, 65)  # that of `FitResult.mesh`, whose program is compiled already
_OFTEN = 0.08  # seconds between two pictures of a running fit
_FEW = 12  # a fit of which fewer rounds were shown was too quick for the eye, and is replayed


class PetalPage:
    """The page of one petal: its controls, target, fit and drawings."""

    def __init__(self, session: Session) -> None:
        self._session, self._scenery = session, session.scenery
        self._target: AbstractObservation | None = None
        self._drawn: AbstractDrawn | None = None
        self._photo: Photo | None = None
        self._result: FitResult | None = None
        self._model: AbstractSurface | None = None
        self._prepared: FitResult | None = None
        self._history: list[Glimpse] = []
        self._costs: list[float] = []
        self._sliders: list[Any] = []
        self._rounds: list[Any] = []
        self._controls = PetalControls(session.gui)
        self.place = self._controls.place
        self._connect()

    def _connect(self) -> None:
        """Connects each control to its action."""
        reacting, controls = self._session.reacting, self._controls
        controls.upload.on_upload(reacting(self._uploaded))
        controls.case.on_update(reacting(lambda _: self.open_case()))
        controls.again.on_click(reacting(lambda _: self._cut_again()))
        controls.go.on_click(reacting(lambda _: self._fit()))
        controls.turn.on_click(reacting(lambda _: self._fit_turned()))
        controls.stop.on_click(lambda _: self._cancel())
        controls.start.on_update(reacting(lambda _: self._show_start()))
        for name, button in controls.files.items():
            button.on_click(reacting(lambda _, name=name: self._download(name)))
        for box in (controls.show_surface, controls.show_points, controls.show_normals):
            box.on_update(self._session.latest(self.draw))

    def leave(self) -> None:
        """Ends the fit when another page is shown, because it would draw into that page."""
        self._session.forget()
        self._at_rest()

    def open(self) -> None:
        """Shows the petal and its target again."""
        self._scenery.clear()
        if self._drawn is not None:
            self._drawn.look()
        self.draw(look=True)

    # The target.

    def open_case(self) -> None:
        """Makes the selected case the target."""
        case = CASES[self._controls.case.value]
        target = make(case) if case.points else make_masks(case)[0]
        pose = "similarity" if case.unit != 1.0 else "rigid" if any(case.turn) else "known"
        self._take(target, "", pose, "robust" if case.strays else "linear")

    def _uploaded(self, event: Any) -> None:
        file = event.target.value
        read = read_upload(file.name, file.content)
        if isinstance(read, Camera):
            if not isinstance(self._target, Silhouette):
                raise TargetError("a camera is of a mask: open the mask first, then its camera.")
            mask = Silhouette(self._target.mask, read, self._target.weights)
            self._take(mask, f"a mask with the camera of {file.name}", "known", "linear")
        elif isinstance(read, FitResult):
            self._take(read.agreements[0].target, f"the fit of {file.name}", "known", "linear")
            self._present(read)
            self._session.begin(lambda _: self._prepare_sliders(read))
        elif isinstance(read, FlowerResult):
            raise TargetError(f"{file.name} is a whole flower; open it on the page Flower scan.")
        elif isinstance(read, Photo):
            self._take_photo(read, file.name)
        elif isinstance(read, Silhouette):
            self._take(read, f"{file.name}, a mask", "known", "linear")
        else:
            self._take(read, f"{file.name}, {read.described}", "similarity", "linear")
            self._controls.kind.value = FOR_SCANS.__name__

    def _take_photo(self, photo: Photo, name: str) -> None:
        self._take(photo.target, f"{name}, a photo; is this the petal?", "known", "linear", photo)

    def _cut_again(self) -> None:
        assert self._photo is not None, "the button shows with a photo"
        x, y = self._controls.spot.value
        self._take_photo(Photo.of(self._photo.picture, (float(x), float(y))), "cut out again")

    def _take(
        self,
        target: AbstractObservation,
        about: str,
        pose: str,
        loss: str,
        photo: Photo | None = None,
    ) -> None:
        """Sets a new target, and the options that suit it."""
        self._session.forget()
        self._at_rest()
        self._target, self._photo, self._result, self._model = target, photo, None, None
        self._history, self._costs = [], []
        self._controls.about.content = words.text(about)
        self._controls.state.content = ""
        self._controls.pose.value, self._controls.loss.value = pose, loss
        self._drawn = on_page = drawn(target, self._scenery, self._controls)
        if photo is not None and isinstance(on_page, DrawnMask):
            on_page.photo = photo.picture
        kind = models().get(self._controls.kind.value)  # none for "auto"
        if on_page.in_picture and (kind is None or not family_of(kind).sees_outlines):
            self._controls.kind.value = DEFAULT.__name__
        self._hide_result()
        self._controls.cut.visible = photo is not None
        self._controls.picture.visible = on_page.in_picture
        self._scenery.clear()
        on_page.look()
        self.draw()

    def _hide_result(self) -> None:
        controls = self._controls
        for part in (controls.found, controls.numbers, controls.key, controls.turn):
            part.visible = False

    # The fit.

    def _fit_turned(self) -> None:
        """Fits again, with the tip of the last result as the base."""
        assert self._result is not None, "the button shows with a result"
        self._fit(base=tip_of(self._result))

    def _fit(self, base: tuple[float, ...] | None = None) -> None:
        if self._session.busy and self._result is None:
            raise TargetError("a fit is running; wait for it, or cancel it first.")
        target = self._target
        assert target is not None, "a page opens with a case"
        kind = self._controls.kind.value
        options = {
            "model": kind if kind == "auto" else models()[kind],
            "pose": self._controls.pose.value,
            "loss": self._controls.loss.value,
            "base": base,
        }
        self._history, self._costs, self._result, self._model = [], [], None, None
        self._hide_result()
        self._controls.stop.visible, self._controls.go.disabled = True, True
        self._controls.state.content = words.progress("waiting for a core", [])
        self._session.begin(lambda work: self._run(work, target, options))

    def _run(self, work: Work, target: AbstractObservation, options: dict[str, Any]) -> None:
        """Runs the fit in a thread of its own, and shows its rounds and its outcome."""
        session, drawn, shown = self._session, [0.0], [0]
        stage = ["beginning"]

        def tell(text: str) -> None:
            work.check()
            stage[0] = text + session.waiting
            with session.turn():
                self._controls.state.content = words.progress(stage[0], self._costs)

        def look(glimpse: Glimpse) -> None:
            work.check()
            self._remember(glimpse)
            if time.monotonic() - drawn[0] > _OFTEN:
                with session.turn():
                    work.check()
                    self._draw_glimpse(glimpse, first=shown[0] == 0)
                    self._controls.state.content = words.progress(stage[0], self._costs)
                drawn[0] = time.monotonic()
                shown[0] += 1

        def fit() -> FitResult:
            with looking_on(look):
                return fit_petal(target, throw=False, progress=tell, **options)

        outcome = session.outcome_of(work, fit, self._present, self._called_off)
        with session.turn():
            if not session.wants(work):
                return
            self._at_rest()
            self._controls.state.content = words.progress("", self._costs) if self._costs else ""
            outcome()
        result = self._result
        if result is None or not session.wants(work):
            return
        if shown[0] < _FEW:
            self._replay(work)
        self._prepare_sliders(result)

    def _remember(self, glimpse: Glimpse) -> None:
        self._history.append(glimpse)
        if len(glimpse.distances):
            self._costs.append(float(np.sqrt(np.mean(glimpse.distances**2))))

    def _at_rest(self) -> None:
        self._controls.stop.visible, self._controls.go.disabled = False, False

    def _cancel(self) -> None:
        """Cancels the fit at once, without waiting for the turn of another reaction."""
        self._at_rest()
        # The end of the fit, which may come at once, has the last word.
        self._controls.state.content = words.soft("cancelling; a step that has begun ends first")
        self._session.call_off()

    def _called_off(self) -> None:
        self._controls.state.content = words.soft("cancelled; the petal is where it stood")

    def _replay(self, work: Work) -> None:
        """Shows the rounds again, slowly enough to be seen."""
        result = self._result
        for k, glimpse in enumerate(self._history[-3 * _FEW :]):
            with self._session.turn():
                if not self._session.wants(work) or self._is_edited:
                    return
                self._draw_glimpse(glimpse, first=k == 0)
            time.sleep(_OFTEN)
        with self._session.turn():
            if self._session.wants(work) and self._result is result:
                self.draw(look=True)

    def _prepare_sliders(self, result: FitResult) -> None:
        """Lets distances follow the sliders, once the program that this needs is compiled."""
        on_page = self._drawn
        assert on_page is not None, "a result has a target"
        with self._session.compiled():
            measured = on_page.prepare(result)
        if measured:
            with self._session.turn():
                self._prepared = result
                if self._is_edited:
                    self.draw()

    def _present(self, result: FitResult) -> None:
        """Shows the result of a fit."""
        self._result, self._model = result, result.model
        self._controls.verdict.content = words.verdict(result)
        self._controls.table.content = words.table(result)
        self._controls.start.options = [FITTED, *_ends(result)]
        self._controls.start.value = FITTED
        self._controls.found.visible = self._controls.numbers.visible = True
        # An end that is the base by mistake can be the tip only where the pose was fitted.
        fitted = bool(result.pose_stderr) or result.in_image
        may_turn = "base" in family_of(result.model).takes and fitted
        self._controls.turn.visible = bool(may_turn)
        self._add_sliders(result.model)
        self._add_rounds()
        part = result.agreements[0]
        assert self._drawn is not None, "a result has a target"
        self._controls.key.content = words.key(distance_limit(part), self._drawn.unit)
        self._controls.key.visible = not self._drawn.in_picture
        self.draw(look=True)

    def _add_rounds(self) -> None:
        """Adds a slider through the rounds of the last fit."""
        self._controls.round.visible = len(self._history) > 1
        for child in self._rounds:
            child.remove()
        self._rounds = []
        if len(self._history) < 2:
            return
        last = len(self._history) - 1
        with self._controls.round:
            handle = self._session.gui.add_slider(
                "Round", 0, last, 1, last, hint="The petal after each round of the fit"
            )
        handle.on_update(
            self._session.latest(lambda: self._draw_glimpse(self._history[int(handle.value)]))
        )
        self._rounds.append(handle)

    # The drawing.

    @property
    def _is_edited(self) -> bool:
        return self._result is not None and self._model is not self._result.model

    def _show_start(self) -> None:
        result = self._result
        if result is None:
            return
        model = result.model
        chosen = _ends(result).get(self._controls.start.value)
        if chosen is not None:
            for name in set(chosen.values) & set(parameters(model)):
                model = with_value(model, name, np.float64(chosen.values[name]))
        self._model = model
        self._add_sliders(model)
        self.draw()

    def _add_sliders(self, model: AbstractSurface) -> None:
        gui = self._session.gui
        for handle in self._sliders:
            handle.remove()
        self._sliders = []
        with self._controls.numbers:
            for name, parameter in parameters(model).items():
                value = float(value_at(model, name))
                handle = add_slider(gui, name, parameter, value, self._session.latest(self._moved))
                self._sliders.append(handle)

    def _moved(self) -> None:
        """Sets the petal to the values of the sliders, and draws it."""
        if self._model is None:
            return
        model = self._model
        for name, handle in zip(parameters(model), self._sliders, strict=True):
            lowest = 0.6 * handle.step
            if abs(float(value_at(model, name)) - handle.value) > lowest:
                model = with_value(model, name, np.float64(handle.value))
        if model is not self._model:
            self._model = model
            self.draw()

    def draw(self, look: bool = False) -> None:
        """Draws the petal and the target; `look` moves the viewer to a new place."""
        on_page, result, model = self._drawn, self._result, self._model
        if on_page is None:
            return
        pose = Pose.identity() if result is None else result.pose
        if model is not None:
            self._draw_surface(model, look)
        rms = on_page.draw(model, pose, result, measured=self._prepared is result)
        if result is not None:
            edited = words.edited(result, rms, on_page.unit) if self._is_edited else ""
            self._controls.edited.content = edited

    def _draw_surface(self, model: AbstractSurface, look: bool) -> None:
        # All numbers are doubles, so that one program serves all models.
        mesh = in_doubles(model).mesh(_RESOLUTION)
        vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
        if look:
            self._scenery.look_at(vertices)
        self._scenery.surface(vertices, np.asarray(mesh.faces), self._controls.show_surface.value)
        self._scenery.normals(vertices, normals, self._controls.show_normals.value)

    def _draw_glimpse(self, glimpse: Glimpse, first: bool = False) -> None:
        model, points = glimpse.model, glimpse.points
        if self._drawn is not None:
            self._drawn.glimpse(model)
        if isinstance(model, Posed):
            # The petal stays in its own frame, and the points are moved into it.
            points, model = model.placement.into(points), model.surface
        self._draw_surface(model, first)
        limit = 3 * float(np.median(np.abs(glimpse.distances))) if len(points) else 1.0
        colours = diverging(glimpse.distances / max(limit, 1e-300))
        self._scenery.points(points, colours, self._controls.show_points.value)

    # Downloads.

    def _download(self, name: str) -> None:
        result, model = self._result, self._model
        assert result is not None, "the buttons show with a result"
        assert model is not None, "a result has a model"
        if name == "petal.glb" and self._is_edited:
            values = {each: float(value_at(model, each)) for each in parameters(model)}
            result = dataclasses.replace(
                result, model=model, values=result.values | values, stderr={}, identifiable={},
                names=(), covariance=np.zeros((0, 0)),
            )  # fmt: skip
        write = {
            "fit.json": FitResult.save,
            "petal.glb": export_glb,
            "report.html": write_report,
        }[name]
        self._session.download(name, lambda path: write(result, path))


def _ends(result: FitResult) -> dict[str, Start]:
    """The end points of the other starts, by their names on the page."""
    return {
        f"{'rival' if start in result.rivals else 'start'}: {start.label}, "
        f"Δχ² {start.delta_chi2:.3g}": start
        for start in result.starts[1:]
        if np.isfinite(start.delta_chi2)
    }
