"""The controls of the page of one petal, in their order from top to bottom."""

from __future__ import annotations

import numpy as np
import viser

from petalfit.components import models
from petalfit.fitting import DEFAULT, LOSSES
from petalfit.studio import words
from petalfit.synthetic import RECIPES

_FIRST = "noisy:"
CASES = {
    f"{case.name}: {case.about}": case
    for case in RECIPES
    if len(case.sights) + (case.points > 0) == 1
}
FITTED = "the fit"
_WELCOME = (
    "Open a scan, a mesh, a mask or a photo of a petal, or choose a case; then fit it. "
    "Nothing leaves this computer."
)
FILES = {
    "fit.json": "All numbers of the fit; open it here again, or with pf.FitResult.load",
    "petal.glb": "The petal as it is shown, as glTF with its parameters in extras",
    "report.html": "One page with tables and pictures, which needs no network",
}


class PetalControls:
    """The buttons, choices and texts of the page; `PetalPage` connects them to actions."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self.place = gui.add_folder(None)
        with self.place:
            gui.add_html(words.soft(_WELCOME))
            self.upload = gui.add_upload_button(
                "Open a file",
                icon=viser.Icon.UPLOAD,
                hint="A cloud or mesh (.ply .obj .stl .glb .xyz .txt .csv .npy .npz), a mask or photo "
                "(.png .jpg .tif ...), the camera of the mask or an earlier fit (.json)",
            )
            self.case = gui.add_dropdown(
                "Case",
                [*CASES],
                initial_value=next(name for name in CASES if name.startswith(_FIRST)),
            )
            self.about = gui.add_html("")
            self.picture = gui.add_image(np.full((2, 2, 3), 255, np.uint8), visible=False)
            with gui.add_folder(None, visible=False) as self.cut:
                self.spot = gui.add_vector2(
                    "On the petal", (0.0, 0.0), step=1.0,
                    hint="A place on the petal, in pixels from the left and from the top of the photo",
                )  # fmt: skip
                self.again = gui.add_button("Cut it out again", icon=viser.Icon.SCISSORS)
            with gui.add_folder("Fit"):
                self.kind = gui.add_dropdown(
                    "Model", ["auto", *models()], initial_value=DEFAULT.__name__,
                    hint="auto fits every family of petals and keeps the one that explains a cloud best",
                )  # fmt: skip
                self.pose = gui.add_dropdown(
                    "Pose", ["known", "rigid", "similarity"],
                    hint="known: in the model's frame and unit; rigid: anywhere, in its unit; "
                    "similarity: anywhere, in any unit",
                )  # fmt: skip
                self.loss = gui.add_dropdown(
                    "Loss", [*LOSSES],
                    hint="; ".join(f"{loss.name}: {loss.meaning}" for loss in LOSSES.values()),
                )  # fmt: skip
                self.go = gui.add_button("Fit", color="teal", icon=viser.Icon.PLAYER_PLAY)
                self.turn = gui.add_button(
                    "Exchange base and tip", icon=viser.Icon.ARROWS_EXCHANGE, visible=False,
                    hint="Fits again, with the other end as the base",
                )  # fmt: skip
                self.stop = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)
                self.state = gui.add_html("")
            with gui.add_folder("Result", visible=False) as self.found:
                self.verdict = gui.add_html("")
                self.table = gui.add_html("")
                self.start = gui.add_dropdown(
                    "Show", [FITTED], hint="Other starts of the fit, and where they ended"
                )
                self.round = gui.add_folder(None)
                with gui.add_folder("Download", expand_by_default=True):
                    self.files = {
                        name: gui.add_button(name, icon=viser.Icon.DOWNLOAD, hint=hint)
                        for name, hint in FILES.items()
                    }
            with gui.add_folder("Parameters", visible=False) as self.numbers:
                self.edited = gui.add_html("")
            with gui.add_folder("View"):
                self.show_surface = gui.add_checkbox("surface", True)
                self.show_points = gui.add_checkbox("points", True)
                self.show_normals = gui.add_checkbox("normals", False)
                self.key = gui.add_html("", visible=False)
