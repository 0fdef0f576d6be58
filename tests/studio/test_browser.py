"""The studio as somebody uses it who looks at it in a browser."""

import re
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from playwright.sync_api import Page, expect

import petalfit as pf
from tests.browser import A_WHILE, Watched
from tests.fitting.test_flower import corolla

PETAL = pf.PeonyPetal(a_x=14.0, b_y=22.0, c=0.6, dx=0.4, dy=3.0)


@pytest.fixture
def opened(browser, url):
    """A page of its own, which must not have complained, nor asked anybody else for anything."""
    page = browser.new_page(viewport={"width": 1280, "height": 1000})
    page.set_default_timeout(A_WHILE)
    watched = Watched(page)
    page.goto(url)
    expect(page.get_by_text("Open a file")).to_be_visible()
    expect(page.get_by_role("button", name="Fit", exact=True)).to_be_enabled()
    yield page
    page.close()
    assert not watched.errors
    assert not watched.beyond(url, url.replace("http", "ws"))


def upload(page: Page, path: Path) -> None:
    page.set_input_files("input[type=file]", path)


def fit(page: Page) -> None:
    page.get_by_role("button", name="Fit", exact=True).click()
    expect(page.get_by_text("converged")).to_be_visible()


def choose(page: Page, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).click()
    page.get_by_role("option", name=option, exact=True).click()


def value(page: Page, name: str) -> float:
    row = page.locator("tr", has=page.locator("code", has_text=re.compile(f"^{name}$")))
    return float(row.locator("td").nth(1).inner_text().split("±")[0].strip(" ≈").replace("−", "-"))


def complaint(page: Page, sentence: str) -> None:
    expect(page.get_by_text(sentence, exact=False).first).to_be_visible()


@pytest.fixture
def cloud(tmp_path):
    np.savetxt(tmp_path / "cloud.xyz", PETAL.sample(1500, seed=1, noise=0.05).points)
    return tmp_path / "cloud.xyz"


def test_a_cloud_is_fitted_edited_and_taken_home(opened, cloud, tmp_path):
    upload(opened, cloud)
    complaint(opened, "cloud.xyz, 1,500 points")
    choose(opened, "Model", "PeonyPetal")
    choose(opened, "Pose", "known")
    fit(opened)
    assert value(opened, "a_x") == pytest.approx(14.0, abs=0.2)
    assert value(opened, "dy") == pytest.approx(3.0, abs=0.1)
    # A slider follows the keyboard, and the petal and its distances follow the slider.
    thumb = opened.get_by_role("slider").nth(2)
    thumb.focus()
    for _ in range(20):
        thumb.press("ArrowRight")
    edited = opened.get_by_text("as the sliders say: rms")
    expect(edited).to_be_visible()
    expect(edited).not_to_have_text(re.compile(r" 1 times the fit's"))
    with opened.expect_download() as download:
        opened.get_by_role("button", name="petal.glb").click()
    download.value.save_as(tmp_path / "petal.glb")
    mesh = trimesh.load(tmp_path / "petal.glb", force="mesh")
    assert len(mesh.vertices) == 65 * 65
    with opened.expect_download() as download:
        opened.get_by_role("button", name="fit.json").click()
    download.value.save_as(tmp_path / "fit.json")
    result = pf.FitResult.load(tmp_path / "fit.json")
    assert result.values["b_y"] == pytest.approx(22.0, abs=0.2)
    edited_box, fitted_box = np.ptp(mesh.vertices, axis=0), np.ptp(result.mesh().vertices, axis=0)
    assert not np.allclose(edited_box, fitted_box, rtol=1e-4)


def test_a_mask_and_its_camera_are_fitted(opened, tmp_path):
    camera = pf.Camera.look_at((30, -40, 70), (0, 12, 0), (256, 256), pixels_per_unit=4.5)
    smooth = pf.PeonyPetal(a_x=14.0, b_y=22.0, c=0.6, dx=0.4, dy=3.0, rib_amplitude=0.0)
    smooth.silhouette(camera).save(tmp_path / "mask.png")
    (tmp_path / "camera.json").write_text(camera_json(camera))
    upload(opened, tmp_path / "mask.png")
    complaint(opened, "mask.png, a mask")
    upload(opened, tmp_path / "camera.json")
    complaint(opened, "with the camera of camera.json")
    fit(opened)
    assert value(opened, "a_x") == pytest.approx(14.0, abs=0.1)
    assert value(opened, "b_y") == pytest.approx(22.0, abs=0.1)


def camera_json(camera: pf.Camera) -> str:
    import json

    return json.dumps(
        {
            "rotation": np.asarray(camera.rotation).tolist(),
            "pixels_per_unit": 4.5,
            "centre": camera.project(np.zeros((1, 3)))[0].tolist(),
            "shape": [256, 256],
        }
    )


def test_what_cannot_be_used_is_said(opened, cloud, tmp_path):
    (tmp_path / "notes.docx").write_bytes(b"no petal")
    upload(opened, tmp_path / "notes.docx")
    complaint(opened, "notes.docx is of no kind that can be fitted")
    (tmp_path / "wrong.ply").write_bytes(cloud.read_bytes())
    upload(opened, tmp_path / "wrong.ply")
    complaint(opened, "wrong.ply: is no PLY file")
    (tmp_path / "empty.npy").touch()
    upload(opened, tmp_path / "empty.npy")
    complaint(opened, "empty.npy is empty")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("points.npy", bytes(300_000_000))
    upload(opened, tmp_path / "bomb.npz")
    complaint(opened, "bomb.npz: it unpacks to 300 MB")
    with (tmp_path / "huge.ply").open("wb") as huge:
        huge.truncate(500_000_000)
    upload(opened, tmp_path / "huge.ply")
    complaint(opened, "huge.ply holds 500 MB; this page takes 100 MB")
    from PIL import Image

    Image.fromarray(np.full((90, 120, 3), 200, np.uint8)).save(tmp_path / "wall.jpg")
    upload(opened, tmp_path / "wall.jpg")
    complaint(opened, "nothing stands out from the border of the photo")
    # And it goes on.
    fit(opened)


def test_browsers_do_not_disturb_each_other(opened, browser, url, cloud):
    choose(opened, "Case", "half: the half with x < 0 was not seen")
    opened.get_by_role("button", name="Fit", exact=True).dblclick()
    # Somebody else begins a fit and goes away.
    other = browser.new_page()
    other.set_default_timeout(A_WHILE)
    other.goto(url)
    expect(other.get_by_role("button", name="Fit", exact=True)).to_be_enabled()
    other.get_by_role("button", name="Fit", exact=True).click()
    time.sleep(0.2)
    other.close()
    expect(opened.get_by_text("converged")).to_be_visible()
    expect(opened.get_by_text("half: the half").first).to_be_attached()


def test_a_flower_grows_and_is_taken_home(opened, tmp_path):
    opened.get_by_role("button", name="Flower", exact=True).click()
    expect(opened.get_by_text("6 petals, 6 stamens, 1 pistil")).to_be_visible()
    with opened.expect_download() as download:
        opened.get_by_role("button", name="flower.glb").click()
    download.value.save_as(tmp_path / "flower.glb")
    scene = trimesh.load(tmp_path / "flower.glb")
    assert {"petal_1", "petal_6"} <= set(scene.graph.nodes_geometry)


def turn_to_scans(page: Page) -> None:
    page.get_by_role("button", name="Flower scan", exact=True).click()
    expect(page.get_by_role("button", name="Open a scan")).to_be_visible()
    expect(page.get_by_role("button", name="Open a file")).to_be_hidden()


def test_petals_of_a_scanned_flower_are_found_shown_and_grown(opened, tmp_path):
    points, _ = corolla(3)
    np.save(tmp_path / "scan.npy", points)
    turn_to_scans(opened)
    upload(opened, tmp_path / "scan.npy")
    complaint(opened, "scan.npy, 1,500 points")
    opened.get_by_role("button", name="Find the petals").click()
    expect(opened.get_by_text("✓ 3 petals, whorls of 3")).to_be_visible()
    choose(opened, "Show", "petal_2")
    assert 0.1 < value(opened, "width") < 1.5
    files = {}
    for name in ("flower.json", "petals.csv"):
        with opened.expect_download() as download:
            opened.get_by_role("button", name=name).click()
        files[name] = tmp_path / name
        download.value.save_as(files[name])
    result = pf.FlowerResult.load(files["flower.json"])
    assert result.count == 3
    assert result.table() == files["petals.csv"].read_text("utf-8")
    # The file opens the flower again, on this page and on no other.
    upload(opened, files["flower.json"])
    complaint(opened, "the flower of flower.json")
    opened.get_by_role("button", name="Grow it").click()
    expect(opened.get_by_text("3 petals", exact=True)).to_be_visible()
    choose(opened, "Flower", "lily")
    expect(opened.get_by_text("6 petals, 6 stamens, 1 pistil")).to_be_visible()
    choose(opened, "Flower", "the scanned one")
    expect(opened.get_by_text("3 petals", exact=True)).to_be_visible()
    opened.get_by_role("button", name="Petal", exact=True).click()
    expect(opened.get_by_role("button", name="Open a file")).to_be_visible()
    upload(opened, files["flower.json"])
    complaint(opened, "flower.json is a whole flower; open it on the page Flower scan")


def test_the_search_for_petals_is_cancelled_and_begun_again(opened, tmp_path):
    turn_to_scans(opened)
    (tmp_path / "mask.png").write_bytes(disc_png())
    upload(opened, tmp_path / "mask.png")
    complaint(opened, "open it on the page Petal")
    np.save(tmp_path / "scan.npy", corolla(3)[0])
    upload(opened, tmp_path / "scan.npy")
    complaint(opened, "scan.npy, 1,500 points")
    opened.get_by_role("button", name="Find the petals").click()
    opened.get_by_role("button", name="Cancel").click()
    expect(opened.get_by_text("cancelled", exact=True)).to_be_visible()
    opened.get_by_label("Petals", exact=True).fill("3")
    opened.get_by_role("button", name="Find the petals").click()
    expect(opened.get_by_text("✓ 3 petals, whorls of 3")).to_be_visible()


def disc_png() -> bytes:
    import io

    from PIL import Image

    file = io.BytesIO()
    disc = np.hypot(*np.mgrid[-50:50, -50:50]) < 30
    Image.fromarray(np.where(disc, 255, 0).astype(np.uint8)).save(file, format="PNG")
    return file.getvalue()
