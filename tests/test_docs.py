"""What the documentation shows works."""

import json
import re
from pathlib import Path

import jax
import pytest

from petalfit.flowers import flower_from_json

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def blocks(page: str, language: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_the_flower_of_the_page_grows(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    flower, slope, *_ = blocks("flowers.md", "python")
    with jax.enable_x64(True):
        exec(flower, names)
        exec(slope, names)
    assert (tmp_path / "windflower.glb").exists()
    assert names["slope"].series[0].organ.dy.shape == (8,)


def test_the_file_of_the_page_is_the_same_flower():
    (text,) = blocks("flowers.md", "json")
    flower = flower_from_json(json.loads(text))
    assert [len(series) for series in flower.series] == [8, 20, 1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_and_pictures_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+?)\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page} points to {target}"


def test_every_figure_of_the_paper_has_its_picture():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert all(f"gallery/figure_{k}.png" in text for k in range(1, 10))


def test_figures_of_the_readme_are_those_of_the_results():
    """Each row of its table names a row of the benchmarks, and has the number that stands there."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    results = (ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| .+ \| ([\d.]+)([^|]*) \| `([\w.]+)` \|$", text, re.MULTILINE)
    assert len(rows) > 10
    for number, unit, name in rows:
        label = name.partition(".")[2].replace("_", " ")
        assert re.search(
            rf"^\| {label} \| {re.escape((number + unit).strip())} \|", results, re.M
        ), name
    assert len(text.splitlines()) <= 120
