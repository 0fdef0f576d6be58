"""The 3-D view of a report: what is in the page, and what a browser makes of it."""

import base64
import dataclasses
import hashlib
import io
import json
import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from petalfit import Camera, FitResult, PointCloud, Silhouette, Status
from petalfit.report.colour import POSITIVE
from petalfit.report.scene import OBLIQUE, Scene
from petalfit.report.viewer import viewer
from petalfit.results import Agreement
from tests.browser import A_WHILE
from tests.fitted import NOISE, changed, known_pose, posed

SCRIPT = re.compile(r"<script(.*?)>(.*?)</script>", re.DOTALL)
TYPES = {"position": "<u2", "normal": "i1", "value": "i1"}


def scene_in(page: str) -> dict:
    """What the page's script is given."""
    return next(json.loads(text) for kind, text in SCRIPT.findall(page) if "json" in kind)


def array(part: dict, name: str) -> np.ndarray:
    """Numbers as the script decodes them."""
    text = part[name]["data"] if name == "position" else part[name]
    raw = np.frombuffer(base64.b64decode(text), TYPES[name])
    if name == "value":
        return raw / 127
    raw = raw.reshape(-1, 3)
    if name == "normal":
        return raw / 127
    return np.array(part["position"]["low"]) + raw / 65535 * np.array(part["position"]["size"])


def figure(result: FitResult) -> str:
    clouds = [part for part in result.agreements if isinstance(part.target, PointCloud)] or [None]
    return viewer(result, [Scene.of(result, part) for part in clouds], clouds)


def write(result: FitResult, folder) -> str:
    result.report(folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


class TestContent:
    def test_surface_and_normals_are_the_models(self):
        part = scene_in(figure(posed()))["parts"][0]
        mesh = posed().model.mesh()
        assert part["grid"] == [65, 65]
        expected = posed().pose.scale * mesh.vertices
        step = np.ptp(expected, axis=0).max() / 65535
        np.testing.assert_allclose(array(part, "position"), expected, atol=step)
        np.testing.assert_allclose(array(part, "normal"), mesh.vertex_normals, atol=0.51 / 127)

    def test_points_and_distances_are_the_targets(self):
        _, used, ignored = scene_in(figure(posed()))["parts"]
        (agreement,) = posed().agreements
        pose = posed().pose
        points = (agreement.target.points - pose.translation) @ pose.rotation
        for part, which in ((used, agreement.weights > 0), (ignored, agreement.weights == 0)):
            assert part["count"] == which.sum()
            found, expected = array(part, "position"), points[which]
            order, wanted = np.lexsort(found.T), np.lexsort(expected.T)
            step = np.ptp(expected, axis=0).max() / 65535
            np.testing.assert_allclose(found[order], expected[wanted], atol=step)
        values = np.sort(np.clip(agreement.distances[agreement.weights > 0] / (3 * NOISE), -1, 1))
        np.testing.assert_allclose(np.sort(array(used, "value")), values, atol=0.51 / 127)
        assert used["name"] == "points"
        assert ignored["name"] == "ignored points"

    def test_distances_that_are_no_numbers_are_the_middle_of_the_scale(self):
        scene = scene_in(figure(changed(known_pose(), distances=np.full(400, np.nan))))
        assert not array(scene["parts"][1], "value").any()

    def test_one_scale_for_several_clouds(self):
        (part,) = known_pose().agreements
        wide = Agreement(part.target, 4 * part.distances, part.weights, 4 * part.noise)
        result = dataclasses.replace(known_pose(), agreements=(part, wide))
        page = figure(result)
        names = [p["name"] for p in scene_in(page)["parts"]]
        assert names == ["surface", "points 1", "ignored points 1", "points 2", "ignored points 2"]
        assert "<span>0.60</span>" in page
        assert "σ" not in page

    def test_masks_are_looked_at_as_their_camera_did(self):
        result, angle = posed(), 0.3
        turn = np.array(
            [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        camera = Camera.orthographic(turn, 2.0, (40, 40), (80, 80))
        mask = np.zeros((80, 80))
        mask[20:60, 20:60] = 1
        seen = Agreement(Silhouette(mask, camera), np.zeros(9), np.ones(9), 0.1)
        only = dataclasses.replace(result, agreements=(seen,))
        both = dataclasses.replace(result, agreements=(*result.agreements, seen))
        view = scene_in(figure(only))["views"][0]
        assert view["name"] == "camera"
        right, up, back = np.array(view["axes"])
        # A step in the model's frame moves in the image as the camera sees it.
        step = np.array([0.3, -0.2, 0.5])
        x, y = camera.project(result.pose.rotation @ step) - camera.project(np.zeros(3))
        np.testing.assert_allclose([right @ step, up @ step], [x / 2, -y / 2], atol=1e-12)
        np.testing.assert_allclose(back, np.cross(right, up), atol=1e-12)
        assert [p["name"] for p in scene_in(figure(only))["parts"]] == ["surface"]
        assert [v["name"] for v in scene_in(figure(both))["views"]][-1] == "camera"
        np.testing.assert_array_equal(scene_in(figure(both))["views"][0]["axes"], OBLIQUE.axes)

    def test_nothing_to_show(self, tmp_path):
        model = dataclasses.replace(known_pose().model, dx=np.nan)
        page = write(changed(known_pose(), model=model, status=Status.NOT_FINITE), tmp_path)
        assert "There are no pictures" in page
        assert "<script" not in page
        assert "script-src 'none'" in page

    def test_size(self, tmp_path):
        points = np.concatenate(
            [known_pose().agreements[0].target.points + k * 1e-3 for k in range(100)]
        )
        n = len(points)
        many = changed(
            known_pose(),
            target=PointCloud(points),
            distances=np.random.default_rng(0).normal(size=n),
            weights=np.ones(n),
        )
        page = write(many, tmp_path)
        added = sum(len(text) for _, text in SCRIPT.findall(page))
        assert added < 300_000
        assert len(page) < 1_500_000
        assert len(write(known_pose(), tmp_path)) < 1_000_000

    def test_many_surfaces_are_coarser(self):
        scene = Scene.of(known_pose())
        nine = dataclasses.replace(
            scene,
            vertices=np.repeat(scene.vertices, 9, axis=0),
            normals=np.repeat(scene.normals, 9, axis=0),
        )
        page = viewer(known_pose(), [nine], [None])
        part = scene_in(page)["parts"][0]
        found = array(part, "position").reshape(9, 33, 33, 3)
        np.testing.assert_allclose(found, nine.vertices[:, ::2, ::2], atol=1e-3)
        assert array(part, "normal").shape == (9 * 33 * 33, 3)
        assert len(page) < 200_000

    def test_the_policy_allows_this_script_alone(self, tmp_path):
        page = write(posed(), tmp_path)
        (ours,) = [text for kind, text in SCRIPT.findall(page) if not kind]
        digest = base64.b64encode(hashlib.sha256(ours.encode()).digest()).decode()
        policy = re.search(r'Content-Security-Policy" content="(.*?)"', page)[1]
        assert policy.split("; ") == [
            "default-src 'none'", "img-src data:", "style-src 'unsafe-inline'",
            f"script-src 'sha256-{digest}'",
        ]  # fmt: skip


class Opened:
    """A report in a browser, and what went wrong in it."""

    def __init__(self, browser, path, **options) -> None:
        self.context = browser.new_context(viewport={"width": 900, "height": 800}, **options)
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.context.set_default_timeout(A_WHILE)
        self.page = self.context.new_page()
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.address = path.as_uri()

    def go(self) -> "Opened":
        self.page.goto(self.address)
        return self

    def picture(self) -> np.ndarray:
        """What the canvas shows, once it is drawn."""
        self.page.evaluate(
            "() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
        )
        shot = np.asarray(Image.open(io.BytesIO(self.page.locator("canvas").screenshot())))
        return shot[8:-8, 8:-8]  # the frame around it tells whether it has the focus

    def until(self, condition: Callable[[], bool]) -> None:
        """Waits for what the page does in its own time."""
        while not condition():
            self.page.wait_for_timeout(20)

    def shows(self, selector: str) -> bool:
        return self.page.locator(selector).first.is_visible()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "report.html"
    posed().report(path)
    return path


@pytest.fixture
def opened(browser, report):
    made = []

    def opening(path=report, **options) -> Opened:
        made.append(Opened(browser, path, **options))
        return made[-1]

    yield opening
    for one in made:
        one.context.close()


class TestInABrowser:
    def test_it_draws_turns_zooms_and_returns(self, opened):
        view = opened().go()
        first = view.picture()
        assert len(np.unique(first.reshape(-1, first.shape[2]), axis=0)) > 1000
        mouse, box = view.page.mouse, view.page.locator("canvas").bounding_box()
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        mouse.move(*middle)
        mouse.down()
        mouse.move(middle[0] + 60, middle[1] + 20, steps=3)
        mouse.up()
        turned = view.picture()
        assert (turned != first).any(axis=-1).mean() > 0.02
        bar = view.page.locator(".scale")
        length = bar.inner_text(), bar.bounding_box()
        mouse.wheel(0, -300)  # which arrives later
        view.until(lambda: (bar.inner_text(), bar.bounding_box()) != length)
        assert (view.picture() != turned).any(axis=-1).mean() > 0.02
        mouse.dblclick(*middle)
        np.testing.assert_array_equal(view.picture(), first)
        for key in ("ArrowLeft", "ArrowUp", "+"):
            before = view.picture()
            view.page.keyboard.press(key)
            assert (view.picture() != before).any(axis=-1).mean() > 0.005, key
        view.page.keyboard.press("0")
        np.testing.assert_array_equal(view.picture(), first)
        for name in ("side", "base", "nearer"):
            before = view.picture()
            view.page.get_by_role("button", name=name).click()
            assert (view.picture() != before).any(axis=-1).mean() > 0.02, name
        assert view.complaints == []
        assert view.requests == [view.address]

    def test_switches_show_and_hide(self, opened):
        view = opened().go()
        boxes = view.page.locator(".switches input")
        names = [boxes.nth(i).get_attribute("name") for i in range(boxes.count())]
        assert names == ["surface", "points", "ignored points", "grid lines", "normals"]
        for i in range(boxes.count()):
            before = view.picture()
            boxes.nth(i).click()
            assert (view.picture() != before).any(), names[i]
        for name in ("grid lines", "normals"):
            view.page.locator(f"input[name='{name}']").uncheck()
        empty = view.picture()
        top = empty[: len(empty) // 2]  # below are axes and bar
        assert (top == top[0, 0]).all()

    def test_colours_are_those_of_the_distances(self, opened, tmp_path):
        distances = np.full(400, 3 * NOISE)
        changed(known_pose(), distances=distances, weights=np.ones(400)).report(tmp_path / "a.html")
        view = opened(tmp_path / "a.html").go()
        view.page.locator("input[name='surface']").uncheck()
        picture = view.picture()[..., :3].astype(int)
        exact = (np.abs(picture - np.rint(255 * POSITIVE)) <= 2).all(axis=-1)
        assert exact.sum() > 400

    def test_a_page_is_scrolled_past_until_it_is_clicked(self, opened):
        view = opened().go()
        canvas = view.page.locator("canvas")
        canvas.scroll_into_view_if_needed()
        before, place = view.picture(), view.page.evaluate("scrollY")
        canvas.hover()
        view.page.mouse.wheel(0, 40)
        view.page.wait_for_function("place => scrollY > place", arg=place)
        np.testing.assert_array_equal(view.picture(), before)

    def test_sharp_on_any_screen_and_as_wide_as_it(self, opened):
        view = opened(device_scale_factor=2).go()
        for width in (900, 390):
            view.page.set_viewport_size({"width": width, "height": 800})
            view.picture()
            canvas = view.page.evaluate(
                "() => (({width, height, clientWidth, clientHeight}) => "
                "[width, height, clientWidth, clientHeight])(document.querySelector('canvas'))"
            )
            assert canvas[:2] == [2 * canvas[2], 2 * canvas[3]]
            assert view.page.evaluate("document.documentElement.scrollWidth") <= width
        assert view.complaints == []

    def test_fingers(self, opened):
        view = opened(has_touch=True).go()
        first = view.picture()
        box = view.page.locator("canvas").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        session = view.context.new_cdp_session(view.page)

        def touch(kind: str, *places: tuple[float, float]) -> None:
            points = [{"x": a, "y": b, "id": i} for i, (a, b) in enumerate(places)]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        def bar() -> float:
            view.picture()
            return view.page.locator(".scale").bounding_box()["width"] / float(
                view.page.locator(".scale").inner_text()
            )

        size = bar()
        touch("touchStart", (x, y))
        for step in range(1, 7):
            touch("touchMove", (x + 15 * step, y))
        touch("touchEnd")
        assert (view.picture() != first).any(axis=-1).mean() > 0.02
        assert bar() == pytest.approx(size)
        touch("touchStart", (x - 40, y), (x + 40, y))
        for step in range(1, 9):
            touch("touchMove", (x - 40 - 5 * step, y), (x + 40 + 5 * step, y))
        touch("touchEnd")
        assert bar() == pytest.approx(2 * size, rel=0.1)
        assert view.complaints == []

    def test_it_is_light_or_dark(self, opened):
        corners = [opened(color_scheme=kind).go().picture()[5, 5, :3] for kind in ("light", "dark")]
        np.testing.assert_array_equal(corners, [[255] * 3, [0x15, 0x15, 0x18]])

    def test_it_rests_when_nothing_happens(self, opened):
        view = opened()
        view.page.add_init_script(
            "window.frames_asked = 0; const ask = window.requestAnimationFrame.bind(window);"
            "window.requestAnimationFrame = (f) => { window.frames_asked++; return ask(f); };"
            "window.frames = async (n) => { while (n--) await new Promise(ask); };"
        )
        view.go()
        view.page.evaluate("window.frames(12)")  # in which one that does not rest asks for twelve
        asked = view.page.evaluate("window.frames_asked")
        view.page.evaluate("window.frames(12)")
        assert view.page.evaluate("window.frames_asked") == asked
        assert 1 <= asked <= 3

    def test_pictures_stand_in_on_paper_without_scripts_and_without_webgl(self, opened):
        usual = opened().go()
        assert usual.shows(".viewer")
        assert not usual.shows(".views")
        usual.page.emulate_media(media="print")
        scriptless = opened(java_script_enabled=False).go()
        glless = opened()
        glless.page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
        for view in (usual, scriptless, glless.go()):
            assert view.shows(".views svg")
            assert not view.shows(".viewer")
        assert glless.complaints == []

    def test_scale_bar(self, opened, tmp_path):
        known_pose().report(tmp_path / "a.html")
        view = opened(tmp_path / "a.html").go()
        view.picture()
        bar = view.page.locator(".scale")
        length, width = float(bar.inner_text()), bar.bounding_box()["width"]
        mantissa = length / 10 ** math.floor(math.log10(length))
        assert any(math.isclose(mantissa, m) for m in (1, 2, 5))
        # Seen from the front, the petal is as wide in pixels as the bar says.
        view.page.get_by_role("button", name="front").click()
        view.page.locator("input[name='points']").uncheck()
        view.page.locator("input[name='ignored points']").uncheck()
        picture = view.picture()
        rows = (picture[: int(0.8 * len(picture)), :, :3] != picture[0, 0, :3]).any(axis=-1)
        seen = np.ptp(np.flatnonzero(rows.any(axis=0))) + 1
        width_of_petal = np.ptp(known_pose().mesh().vertices[:, 0])
        assert seen * length / width == pytest.approx(width_of_petal, rel=0.02)
