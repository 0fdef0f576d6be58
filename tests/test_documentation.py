"""The documentation builds without a warning, its notebooks run, and its pages need no other host."""

import ast
import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest
from sphinx.util.inventory import InventoryFile

import petalfit as pf
from petalfit.compilation.cache import VARIABLE

ROOT = Path(__file__).parents[1]
DOCS, NOTEBOOKS = ROOT / "docs", ROOT / "notebooks"
PAGES = [path for path in sorted(NOTEBOOKS.glob("*.py")) if path.name != "pictures.py"]
# What a browser loads by itself.
LOADING = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("iframe", "src"),
    ("source", "src"),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages, made as `make docs` makes them."""
    folder = tmp_path_factory.mktemp("documentation")
    command = [sys.executable, "-m", "sphinx", "-W", "-n", "-q", "-E", "-c", str(DOCS)]
    command += ["-d", str(folder / "doctrees"), str(ROOT), str(folder / "html")]
    assert VARIABLE in os.environ, "notebooks take programs from the store of all tests"
    before = sources()
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr[-6000:]
    assert sources() == before, "the build leaves nothing beside the sources"
    return folder / "html"


def sources() -> set[Path]:
    """All files of the documentation's folders."""
    found = {path for folder in (DOCS, NOTEBOOKS) for path in folder.rglob("*")}
    return {path for path in found if "__pycache__" not in path.parts}


@pytest.mark.parametrize("notebook", PAGES, ids=lambda path: path.stem)
def test_notebooks_ran_and_show_something(built: Path, notebook: Path) -> None:
    page = built / "notebooks" / f"{notebook.stem}.html"
    text = page.read_text(encoding="utf-8")
    assert "cell_output" in text
    assert re.search(r"<img [^>]*_images/", text), "a notebook has a picture"
    assert "stderr" not in re.findall(r'class="output ([a-z]+)', text)


class Loaded(HTMLParser):
    """Addresses of what a page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "link" and given.get("rel") not in (
            "stylesheet",
            "icon",
            "preload",
            "shortcut icon",
        ):
            return
        self.found += [value for name, value in attrs if (tag, name) in LOADING and value]


def test_pages_load_nothing_from_elsewhere(built: Path) -> None:
    pages = sorted(built.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        parser = Loaded()
        parser.feed(page.read_text(encoding="utf-8"))
        outside = [address for address in parser.found if re.match(r"(?:https?:)?//", address)]
        assert not outside, f"{page.relative_to(built)} loads {outside}"
    for sheet in built.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//", text), sheet


def test_links_between_pages_arrive(built: Path) -> None:
    for page in built.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r'<a [^>]*?href="([^"#?]+)', text):
            if re.match(r"\w+:", target):  # with a scheme: another site's
                continue
            assert (page.parent / target).exists(), f"{page.relative_to(built)} points to {target}"


def test_every_public_name_is_in_the_reference(built: Path) -> None:
    with (built / "objects.inv").open("rb") as file:
        inventory = InventoryFile.load(file, "", lambda base, path: path)
    listed = {name for kind, names in inventory.items() if kind.startswith("py:") for name in names}
    for name in pf.__all__:
        assert f"petalfit.{name}" in listed, name
        for member in own_methods(name):
            assert f"petalfit.{name}.{member}" in listed, f"{name}.{member}"


def own_methods(name: str) -> Iterator[str]:
    """Public methods and properties of a class that no public class above it declares."""
    kind = getattr(pf, name)
    if not inspect.isclass(kind):
        return
    above = [base for base in kind.__mro__[1:] if base.__name__ in pf.__all__]
    fields = getattr(kind, "__dataclass_fields__", {})
    for member, value in vars(kind).items():
        known = any(hasattr(base, member) for base in above)
        function = callable(value) or isinstance(value, property | classmethod | staticmethod)
        if not (member.startswith("_") or known or member in fields) and function:
            yield member


def test_every_command_is_on_its_page(built: Path) -> None:
    text = (built / "docs" / "command_line.html").read_text(encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "petalfit", "--help"], capture_output=True, text=True, check=True
    )
    commands = re.search(r"\{([a-z,]+)\}", done.stdout)
    assert commands
    for command in commands[1].split(","):
        assert f'id="petalfit-{command}"' in text
        assert f"usage: petalfit {command}" in text


def templates() -> list[re.Pattern[str]]:
    """Every sentence of the source as a pattern, with anything where values stand."""
    found = []
    for path in sorted((ROOT / "petalfit").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = node.values
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                parts = [node]
            else:
                continue
            words = [part.value if isinstance(part, ast.Constant) else None for part in parts]
            literal = sum(len(str(word)) for word in words if word is not None)
            if literal >= 15:
                pattern = "".join(".+" if w is None else re.escape(str(w)) for w in words)
                found.append(re.compile(pattern))
    return found


def test_messages_of_the_faq_are_what_petalfit_says() -> None:
    text = (DOCS / "faq.md").read_text(encoding="utf-8")
    quoted = re.findall(r"```text\n(.*?)\n```", text, re.DOTALL)
    assert len(quoted) > 30
    said = templates()
    for message in quoted:
        assert any(pattern.fullmatch(message) for pattern in said), message


@pytest.mark.parametrize(
    "notebook", [*PAGES, NOTEBOOKS / "pictures.py"], ids=lambda path: path.stem
)
def test_notebooks_are_text_without_outputs(notebook: Path) -> None:
    text = notebook.read_text(encoding="utf-8")
    if notebook.name == "pictures.py":
        assert "# %%" not in text
        return
    assert text.startswith("# %% [markdown]\n# # ")
    assert "**Claim.**" in text
    assert "\nassert " in text or "    assert " in text
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    assert f"../notebooks/{notebook.stem}\n" in index
