"""The arrows between petalfit's folders point one way: a folder imports from earlier rows only."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = (
    {"observations"},
    {"compilation"},
    {"surfaces"},
    {"components", "colours"},
    {"residuals"},
    {"fitting"},
    {"batch", "flowers", "synthetic"},
    {"export"},
    {"report"},
    {"studio"},
    {"cli"},
)
ROW = {folder: row for row, folders in enumerate(ROWS) for folder in folders}
# The one arrow back: `FitResult.report` imports what it calls when it is called.
BACK = ("petalfit/fitting/result.py", "petalfit.report.write_report")
SOURCES = sorted(
    path.relative_to(ROOT)
    for path in (ROOT / "petalfit").rglob("*.py*")
    if path.suffix in {".py", ".pyi"}
    and path.relative_to(ROOT / "petalfit").as_posix()
    not in {"__init__.py", "__init__.pyi", "__main__.py"}
)


def imported_names(path: Path) -> Iterator[str]:
    """Absolute dotted names of what a file imports, in functions and for type checkers included."""
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.parent.parts[: len(path.parent.parts) + 1 - node.level]
            origin = ".".join([*(package if node.level else ()), *filter(None, [node.module])])
            yield from (f"{origin}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", SOURCES, ids=str)
def test_imports_point_one_way(path: Path) -> None:
    folder = path.parts[1]
    assert folder in ROW, f"{folder} has no place in the rows above"
    for name in imported_names(path):
        package, _, rest = name.partition(".")
        # The version is the package's own, and no folder.
        if package != "petalfit" or rest == "__version__" or (path.as_posix(), name) == BACK:
            continue
        source = rest.partition(".")[0]
        assert source == folder or ROW.get(source, len(ROWS)) < ROW[folder], (
            f"{path} imports {name}: {folder} may import from "
            f"{sorted(other for other in ROW if ROW[other] < ROW[folder])} only"
        )


def test_the_arrow_back_is_there() -> None:
    path, name = BACK
    assert name in imported_names(Path(path)), "BACK is an exception that nothing needs: remove it"
