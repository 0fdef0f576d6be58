"""The arrows between petalfit's files and folders point one way, and nobody asks for a family's class."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "petalfit"
# A folder imports from earlier rows only.
ROWS = (
    {"version", "schema"},
    {"observations"},
    {"compilation"},
    {"surfaces"},
    {"components", "colours"},
    {"residuals"},
    {"results"},
    {"flowers"},
    {"synthetic"},
    {"export"},
    {"report"},
    {"fitting"},
    {"batch"},
    {"studio"},
    {"cli"},
)
# The same inside `fitting`; its own files come after its folders.
FITTING_ROWS = (
    {"coordinates"},
    {"likelihood"},
    {"solver"},
    {"segmentation"},
    {"outliers"},
    {"starts"},
    {"inference"},
    {"arrangement"},
    {"request"},
    {"families"},
    {"silhouettes"},
    {"colours"},
)
SOURCES = sorted(path.relative_to(ROOT) for path in PACKAGE.rglob("*.py"))
# The kinds of models that have a family of their own.
FAMILIES = {"PeonyPetal", "BladePetal", "SplinePetal", "AbstractAssembly"}
# Where their classes are at home: their declarations, their families with the registry, and what makes
# flowers and test cases of them.
AT_HOME = ("components", "fitting/families", "flowers", "synthetic", "cli/synth.py")


def module_of(path: Path) -> str:
    """The dotted name of a file."""
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


FILES = {module_of(path): path for path in SOURCES}


def is_for_type_checkers(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def imported_names(path: Path) -> Iterator[str]:
    """Absolute dotted names of what a file imports, in functions too, but not for annotations alone."""
    waiting: list[ast.AST] = [ast.parse((ROOT / path).read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if is_for_type_checkers(node):
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.parent.parts[: len(path.parent.parts) + 1 - node.level]
            origin = ".".join([*(package if node.level else ()), *filter(None, [node.module])])
            yield from (f"{origin}.{alias.name}" for alias in node.names)


def imported_files(path: Path) -> set[Path]:
    """The files of petalfit that a file imports: modules, or packages that it takes names from."""
    found = set()
    for name in imported_names(path):
        owner = name.rpartition(".")[0]
        found |= {FILES[one] for one in (name, owner) if one in FILES and FILES[one] != path}
    # A name of a package is no import of the package, if it is a module of its own.
    modules = {FILES[name] for name in imported_names(path) if name in FILES}
    packages = {p for p in found if p.name == "__init__.py" and p not in modules}
    taken = {
        FILES[name.rpartition(".")[0]]
        for name in imported_names(path)
        if name not in FILES and name.rpartition(".")[0] in FILES
    }
    return (found - packages) | (packages & taken)


ARROWS = {path: imported_files(path) for path in SOURCES}


def test_no_file_imports_itself_through_others() -> None:
    done: set[Path] = set()

    def visit(path: Path, above: tuple[Path, ...]) -> None:
        assert path not in above, " → ".join(map(str, (*above[above.index(path) :], path)))
        if path not in done:
            for other in sorted(ARROWS[path]):
                visit(other, (*above, path))
            done.add(path)

    for path in SOURCES:
        visit(path, ())


@pytest.mark.parametrize("rows", [ROWS, FITTING_ROWS], ids=["petalfit", "fitting"])
def test_folders_import_from_earlier_rows_only(rows: tuple[set[str], ...]) -> None:
    depth = 1 if rows is ROWS else 2
    row = {folder: number for number, folders in enumerate(rows) for folder in folders}

    def folder_of(path: Path) -> str | None:
        inside = rows is ROWS or path.parts[1] == "fitting"
        name = path.with_suffix("").parts[depth] if inside and len(path.parts) > depth else ""
        return name if name in row else None

    assert set(row) <= {folder_of(path) for path in SOURCES}, "a row has a folder that is not there"
    for path, others in ARROWS.items():
        source = folder_of(path)
        for target in filter(None, map(folder_of, others)):
            if source is not None and source != target:
                assert row[target] < row[source], f"{path} imports from {target}"


def test_every_folder_has_a_place() -> None:
    placed = set().union(*ROWS)
    for path in SOURCES:
        name = path.with_suffix("").parts[1]
        assert name in placed | {"__init__", "__main__"}, f"{name} has no place in the rows"
    inside = set().union(*FITTING_ROWS)
    folders = {
        path.parts[2] for path in SOURCES if path.parts[1] == "fitting" and len(path.parts) > 3
    }
    assert folders == inside


def test_nobody_asks_for_the_class_of_a_family() -> None:
    asked = []
    for path in SOURCES:
        if path.relative_to("petalfit").as_posix().startswith(AT_HOME):
            continue
        for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
            words = {
                ast.Name: lambda n: n.id,
                ast.Attribute: lambda n: n.attr,
                ast.Constant: lambda n: n.value,
            }.get(type(node), lambda n: None)(node)
            if words in FAMILIES:
                asked.append(f"{path}:{node.lineno} {words}")
    # Docstrings may speak of them; code and strings that stand alone may not.
    assert asked == []
