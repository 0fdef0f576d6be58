import base64
import io
import math
import os
import re
import sys
from html.parser import HTMLParser

import equinox as eqx
import numpy as np
import pytest
from PIL import Image

import petalfit
from petalfit import FitResult, PointCloud, Pose, Status, __version__, parameters
from petalfit.report import provenance, write_picture, write_report
from petalfit.report.colour import NEGATIVE, POSITIVE, ZERO, diverging
from petalfit.report.rounding import measured
from petalfit.results import Posterior
from tests.fitted import HOSTILE, NOISE, changed, known_pose, posed

INLINE = {"span", "sub", "var", "code", "data", "strong", "small"}
VOID = {"meta", "br", "img", "link", "input", "hr"}
ADDRESSES = {"src", "href", "xlink:href", "srcset", "action", "data", "poster", "background"}


class Page(HTMLParser):
    """A page taken apart: well nested, or else an AssertionError."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.rows: list[str] = []  # the text of every table row
        self.parameters: dict[str, str] = {}  # of the rows of the first table, by parameter
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self._open.pop() == tag
        self.text += "" if tag in INLINE else " "
        if tag == "tr" and self._table() == {"class": "parameters"}:
            self.parameters[self.rows[-1].split()[0]] = self.rows[-1]

    def handle_data(self, data):
        if not {"style", "script"} & {*self._open}:
            self.text += data
        if "tr" in self._open:
            self.rows[-1] += data + " "

    def _table(self) -> dict[str, str | None]:
        return next(attributes for tag, attributes in reversed(self.tags) if tag == "table")

    def pictures(self) -> list[np.ndarray]:
        sources = [a["href"] for tag, a in self.tags if tag == "image"]
        return [
            np.asarray(Image.open(io.BytesIO(base64.b64decode(source.split(",", 1)[1]))))
            for source in sources
            if source
        ]


def write(result: FitResult, folder: os.PathLike) -> str:
    path = os.path.join(folder, "report.html")
    result.report(path)
    with open(path, encoding="utf-8") as file:
        return file.read()


@pytest.fixture(scope="module")
def text(tmp_path_factory) -> str:
    return write(posed(), tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


def variant(tmp_path, **changes) -> Page:
    return Page(write(changed(known_pose(), **changes), tmp_path))


class TestContent:
    def test_every_parameter_with_all_its_digits(self, page):
        exact = {a["value"] for tag, a in page.tags if tag == "data"}
        for name, parameter in parameters(posed().model).items():
            assert repr(posed().values[name]) in exact
            assert parameter.meaning in page.parameters[name]

    def test_traits_with_all_their_digits(self, tmp_path):
        known = Posterior(("a_x", "b_y"), np.diag([0.01, 0.04]))
        traits = changed(known_pose(), posterior=known).traits
        page = variant(tmp_path, posterior=known)
        exact = {a["value"] for tag, a in page.tags if tag == "data"}
        assert {repr(trait.value) for trait in traits.values()} <= exact
        words = " ".join(page.text.split())
        for name, trait in traits.items():
            assert re.search(rf"\b{name}\s*{re.escape(trait.meaning)}", words), name
        rounded = " ± ".join(measured(traits["area"].value, traits["area"].stderr))
        assert rounded in words
        assert "error not known" in " ".join(variant(tmp_path).text.split())

    def test_values_are_rounded_to_their_errors(self, page):
        error = posed().stderr["a_x"]
        assert 0.001 <= error < 0.01
        low, high = posed().interval()["a_x"]
        row = re.sub(r"\s+", " ", page.parameters["a_x"])
        assert f"14.0848 ± {error:.4f}" in row
        assert f"{low:.4f} to {high:.4f}" in row
        assert "−0.4" in page.parameters["dx"]

    def test_what_is_not_known_is_said(self, page):
        assert "not determined" in page.parameters["rib_frequency"]
        assert "±" not in page.parameters["rib_frequency"]
        assert "fixed" in page.parameters["midrib_sharpness"]
        assert sum("not determined" in row for row in page.rows) == 1
        assert sum(" fixed " in row for row in page.rows) == 1

    def test_bounds_show_where_they_bind(self, page):
        assert "ended at the bound of its range (1, 100)" in page.parameters["a_x"]
        assert "a_x and dx ended at the bounds of their ranges" in page.text

    def test_headline(self, page):
        words = " ".join(page.text.split())
        assert "PeonyPetal fitted to 360 points converged, with 3 warnings" in words
        size = " × ".join(f"{side:.1f}" for side in posed().agreements[0].target.extent)
        rms = posed().rms
        sentence = (
            f"(40 more without weight) lie {rms:.4f} (rms, {rms / NOISE:.2f} σ) from the surface"
        )
        assert sentence in words
        assert f"noise σ = 0.05, on a target {size} in size" in words.replace("0.0500", "0.05")

    def test_provenance(self, page):
        assert f"petalfit {__version__}" in " ".join(page.text.split())
        assert "petalfit.FitResult, version 6" in page.text
        assert posed().message in page.text
        assert posed().input_hash in page.text
        assert "400 points (360 of them used)" in page.text
        assert "command" not in page.text
        assert repr(posed().pose.scale) in page.text

    def test_the_command_is_quoted(self, tmp_path):
        command = "petalfit fit '<b>a & b.ply' --out out"
        assert command in variant(tmp_path, command=command).text

    def test_a_fitted_pose_has_errors(self, tmp_path):
        pose = Pose(np.eye(3), np.array([1.0, 2.0, 3.0]), 2.0)
        errors = {"scale": 0.01, "shift_y": 0.2, "turn_z": 0.003}
        page = variant(tmp_path, pose=pose, pose_stderr=errors)
        rows = {row.split()[0]: " ".join(row.split()) for row in page.rows if row.strip()}
        assert "2.000 ± 0.010 1.980 to 2.020" in rows["scale"]
        assert "2.00 ± 0.20 1.61 to 2.39 length" in rows["shift_y"]
        assert "± 0.0030 ± 0.0059 rad" in rows["turn_z"]

    def test_a_model_without_names(self, tmp_path):
        nothing = {"names": (), "stderr": {}, "identifiable": {}, "covariance": np.zeros((0, 0))}
        page = variant(tmp_path, **nothing, freedom=116.0)
        assert "effective parameters 116" in " ".join(page.text.split())
        assert "Correlations" not in page.text
        assert "Errors are one standard deviation" not in page.text

    def test_the_model_as_code_makes_the_model(self, page, tmp_path):
        stamen = petalfit.Stamen(tilt=0.25)
        for model in (posed().model, stamen, petalfit.Bowl(hollow="printed")):
            again = eval(provenance._code(model), {"petalfit": petalfit})
            assert eqx.tree_equal(again, model)
        assert provenance._code(petalfit.SplinePetal()) is None

    def test_starts(self, page):
        (row,) = [row for row in page.rows if row.startswith("other ")]
        assert row.split() == ["other", "0.06000", "12.3"]

    def test_correlations_are_numpys(self, page):
        known = [i for i, name in enumerate(posed().names) if name != "rib_frequency"]
        covariance = posed().covariance[np.ix_(known, known)]
        scale = np.sqrt(np.diag(covariance))
        expected = (covariance / np.outer(scale, scale))[np.tril_indices(len(known), -1)]
        rows = [row for row in page.rows if re.fullmatch(r"\w+ ( ?−?[01]\.\d\d)+ ", row)]
        found = [float(x) for row in rows for x in row.replace("−", "-").split()[1:]]
        np.testing.assert_allclose(found, expected, atol=0.00501)


class TestIndependence:
    def test_no_address_leads_elsewhere(self, page, text):
        for tag, attributes in page.tags:
            for name in ADDRESSES & attributes.keys():
                value = attributes[name] or ""
                assert value.startswith(("data:", "#")), (tag, name, value[:80])
            assert not any(name.startswith("on") for name in attributes)
        assert not {"link", "iframe", "img"} & {tag for tag, _ in page.tags}
        style = text[text.index("<style>") : text.index("</style>")]
        assert "@import" not in style
        assert "url(" not in style

    def test_no_address_is_anywhere_in_it(self, tmp_path):
        assert not re.findall(r"https?:|wss?:", write(known_pose(), tmp_path))

    def test_hostile_text_stays_text(self, page, text):
        assert page.text.count(HOSTILE) == 3  # the warning, the message and the label of a start
        scripts = [attributes for tag, attributes in page.tags if tag == "script"]
        assert scripts == [{"type": "application/json"}, {}]

    def test_the_same_result_gives_the_same_bytes(self, text, tmp_path):
        posed().save(tmp_path / "fit.json")
        assert write(FitResult.load(tmp_path / "fit.json"), tmp_path) == text

    def test_no_plotting_library_is_needed(self, text, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        assert write(posed(), tmp_path) == text


class TestPictures:
    def test_they_decode_and_show_something_on_nothing(self, page):
        pictures = page.pictures()
        assert len(pictures) == 4
        for picture in pictures:
            assert picture.shape[2] == 4
            assert set(np.unique(picture[..., 3])) == {0, 255}
            assert (picture[..., 3] == 255).mean() > 0.02
            assert not picture[[0, -1], :, 3].any(), "cut off at the upper or lower edge"
            assert not picture[:, [0, -1], 3].any(), "cut off at the left or right edge"

    def test_the_petals_own_axes_are_used(self, page, tmp_path):
        """A pose turns and scales the target, and the pictures turn it back."""
        for ours, plain in zip(page.pictures(), variant(tmp_path).pictures(), strict=True):
            assert ours.shape == plain.shape
            assert (ours != plain).any(axis=-1).mean() < 0.02

    def test_the_map_has_the_colours_of_the_distances(self, tmp_path):
        for sign, colour in ((1, POSITIVE), (-1, NEGATIVE), (0, ZERO)):
            distances = np.full(400, sign * 3.0 * NOISE)
            picture = variant(tmp_path, distances=distances, weights=np.ones(400)).pictures()[3]
            shown = picture[picture[..., 3] == 255][:, :3]
            np.testing.assert_allclose(shown, np.broadcast_to(255 * colour, shown.shape), atol=0.6)

    def test_colours_of_what_is_no_number(self):
        found = diverging(np.array([np.nan, np.inf, -np.inf]))
        np.testing.assert_allclose(found, [ZERO, POSITIVE, NEGATIVE])

    def test_large_targets_are_thinned_and_that_is_said(self, tmp_path):
        points = np.concatenate(
            [known_pose().agreements[0].target.points + k * 1e-3 for k in range(60)]
        )
        n = len(points)
        page = variant(
            tmp_path, target=PointCloud(points), distances=np.zeros(n), weights=np.ones(n)
        )
        assert "2,500 of 24,000 points, chosen at random" in page.text
        assert "20,000 of 24,000 points, chosen at random" in page.text


class TestPoorFits:
    def test_not_converged_leads(self, tmp_path):
        page = variant(tmp_path, status=Status.ROUND_LIMIT, reason="it moved & moved")
        words = " ".join(page.text.split())
        assert "fitted to 360 points not converged" in words
        assert "round_limit: it moved & moved" in words
        assert "The fit did not converge" in words

    def test_nothing_finite(self, tmp_path):
        names = known_pose().names
        page = variant(
            tmp_path,
            status=Status.NOT_FINITE,
            noise=math.nan,
            distances=np.full(400, np.nan),
            covariance=np.full((len(names), len(names)), np.inf),
            stderr=dict.fromkeys(names, math.inf),
            identifiable=dict.fromkeys(names, False),
        )
        assert sum("not determined" in row for row in page.rows) == len(names)
        assert "there is nothing to correlate" in page.text
        assert "There is no histogram" in page.text

    @pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-3, 1e3, math.inf])
    def test_any_noise(self, tmp_path, noise):
        assert len(variant(tmp_path, noise=noise).pictures()) == 4

    @pytest.mark.parametrize("shift", [[0, 0, 1e3], [1e6, 0, 0], [0, -300, 40]])
    def test_a_target_elsewhere(self, tmp_path, shift):
        points = known_pose().agreements[0].target.points + shift
        page = variant(tmp_path, target=PointCloud(points), distances=np.full(400, 1e3))
        assert len(page.pictures()) == 4
        assert all((picture[..., 3] == 255).any() for picture in page.pictures())

    def test_distances_beyond_the_histogram_are_counted(self, tmp_path):
        distances = known_pose().distances.copy()
        distances[1:4] = 100 * NOISE
        assert "3 distances beyond the ends." in variant(tmp_path, distances=distances).text


class TestPicture:
    def test_it_is_transparent_and_deterministic(self, tmp_path):
        for name in ("a.png", "b.png"):
            write_picture(posed(), tmp_path / name)
        assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
        picture = np.asarray(Image.open(tmp_path / "a.png"))
        assert picture.shape[2] == 4
        assert not picture[[0, -1]][..., 3].any()
        assert (picture[..., 3] == 255).mean() > 0.1


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("write", [write_report, write_picture])
def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, error, write):
    path = tmp_path / "fit.out"
    path.write_bytes(b"old")

    def fail(*_arguments):
        raise error

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(error):
        write(known_pose(), path)
    assert os.listdir(tmp_path) == [path.name]
    assert path.read_bytes() == b"old"
