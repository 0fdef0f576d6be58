"""Every public name says what it is, what it takes, and in which shapes."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator

import pytest

import petalfit as pf

SECTION = re.compile(r"^(Args|Attributes|Returns|Yields|Raises):$", re.MULTILINE)
# "(N, 3)", "(3,)", "shape (n,)", "(x, y)": how an array is laid out.
LAYOUT = re.compile(r"\([^()]*,[^()]*\)|\bshape\b")
# A type alias is described in the reference itself.
ALIASES = {"Scalar"}
NAMES = sorted(set(pf.__all__) - ALIASES)
CLASSES = [name for name in NAMES if inspect.isclass(getattr(pf, name))]
FUNCTIONS = [name for name in NAMES if name not in CLASSES]


def entries(docstring: str, section: str) -> dict[str, str]:
    """What a section says of each name in it."""
    _, found, rest = docstring.partition(f"{section}:\n")
    if not found:
        return {}
    rest = rest.split("\n\n")[0] if section != "Args" else SECTION.split(rest)[0]
    parts = re.split(r"^ {4}(\w+): ", rest, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def check_summary(docstring: str | None, where: str) -> None:
    assert docstring, f"{where} has no docstring"
    summary = docstring.split("\n\n")[0].strip()
    assert summary[-1] in ".:", f"{where}: a summary is a sentence: {summary!r}"
    assert not summary[0].islower() or re.match(r"\w+\(|[a-z]\(", summary), where


def arguments(function: object) -> list[ast.arg]:
    """As they are written, with their annotations."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]  # pyright: ignore
    assert isinstance(tree, ast.FunctionDef)
    every = tree.args
    listed = [*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg]
    return [a for a in listed if a is not None and a.arg not in ("self", "cls")]


def check_arguments(function: object, where: str, wanted: bool) -> None:
    """An entry for each argument, if there is the section, or if it is wanted."""
    docstring = inspect.getdoc(function) or ""
    told = entries(docstring, "Args")
    if not told and not wanted:
        return
    for argument in arguments(function):
        assert argument.arg in told, f"{where}: Args says nothing of {argument.arg}"
        annotation = ast.unparse(argument.annotation) if argument.annotation else ""
        if "ArrayLike" in annotation:  # the shape is not in the annotation
            assert LAYOUT.search(told[argument.arg]), f"{where}: of what shape is {argument.arg}?"
    extra = set(told) - {argument.arg for argument in arguments(function)}
    assert not extra, f"{where}: there is no argument {extra}"


def methods(kind: type) -> Iterator[tuple[str, object]]:
    """Public methods and properties that petalfit's classes declare, inherited ones too."""
    for base in kind.__mro__:
        if not base.__module__.startswith("petalfit"):
            continue
        fields = getattr(base, "__dataclass_fields__", {})
        for name, value in vars(base).items():
            if name.startswith("_") or name in fields:
                continue
            if isinstance(value, classmethod | staticmethod):
                value = value.__func__
            if isinstance(value, property):
                value = value.fget
            value = inspect.unwrap(value) if callable(value) else value
            if inspect.isfunction(value):
                yield name, value


def documented(kind: type, name: str) -> str | None:
    """A method's docstring, or the one where it is declared."""
    for base in kind.__mro__:
        value = vars(base).get(name)
        value = getattr(value, "__func__", value)
        value = value.fget if isinstance(value, property) else value
        text = getattr(value, "__doc__", None)
        if text:
            return inspect.cleandoc(text)
    return None


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name: str) -> None:
    function = inspect.unwrap(getattr(pf, name))
    check_summary(inspect.getdoc(function), name)
    check_arguments(function, name, wanted=True)


@pytest.mark.parametrize("name", CLASSES)
def test_classes(name: str) -> None:
    kind = getattr(pf, name)
    assert kind.__doc__, f"{name} has no docstring"
    assert not kind.__doc__.startswith(f"{name}("), f"{name} has a dataclass's own docstring"
    check_summary(inspect.cleandoc(kind.__doc__), name)
    for member, function in methods(kind):
        where = f"{name}.{member}"
        check_summary(documented(kind, member), where)
        check_arguments(function, where, wanted=False)


@pytest.mark.parametrize("name", CLASSES)
def test_fields(name: str) -> None:
    """A field is a declared parameter, or stands under Attributes, or under Args of the constructor."""
    kind = getattr(pf, name)
    told: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        text = inspect.cleandoc(base.__doc__ or "")
        told |= entries(text, "Attributes") | entries(text, "Args")
    try:
        declared = {path.split(".")[0]: p for path, p in pf.parameters(kind).items()}
    except TypeError:
        declared = {}
    for field in getattr(kind, "__dataclass_fields__", {}):
        if field.startswith("_") or field in declared:
            continue
        assert field in told, f"{name}.{field} is described nowhere"
    for field, parameter in declared.items():
        assert parameter.meaning, f"{name}.{field}"
        assert parameter.unit in ("length", "rad", "1", "px"), f"{name}.{field}: {parameter.unit}"
