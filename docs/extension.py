"""What pages show beyond their text: types as they are written, parameters, the commands' help."""

from __future__ import annotations

import ast
import contextlib
import inspect
import io
import os
import re
import textwrap
from collections.abc import Iterator
from unittest import mock

import tyro
from docutils import nodes
from docutils.parsers.rst import Directive

import petalfit as pf

NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")


def public_link(text: str) -> str | None:
    """Markup that links to a public name, or to a member of one: `FitResult.rivals`."""
    first, *rest = text.removeprefix("petalfit.").removeprefix("pf.").split(".")
    if first not in pf.__all__ or not all(NAME.fullmatch(part) for part in rest):
        return None
    owner = getattr(pf, first)
    if rest and (len(rest) > 1 or not callable(getattr(owner, rest[0], None))):
        return None
    return f":py:obj:`{'.'.join([first, *rest])} <petalfit.{'.'.join([first, *rest])}>`"


def as_type(source: str) -> str:
    """An annotation as markup: literal text, in which public names are links."""
    parts = re.split(r"([A-Za-z_][A-Za-z_0-9.]*)", source.replace("\n", " "))
    found: list[str] = []
    for part in parts:
        link = public_link(part) if part in pf.__all__ else None
        if link:
            found.append(link)
        elif part and found and found[-1].startswith("``"):
            found[-1] = f"{found[-1][:-2]}{part}``"
        elif part:
            found.append(f"``{part}``")
    # A literal neither begins nor ends with a space; outside it is one.
    markup = ""
    for part in found:
        inner = part[2:-2] if part.startswith("``") else part
        before = " " if inner.startswith(" ") else r"\ " if markup and markup[-1] != " " else ""
        after = " " if inner.endswith(" ") else ""
        core = f"``{inner.strip()}``" if part.startswith("``") and inner.strip() else inner.strip()
        markup += (before if core else " ") + core + after
    return markup.strip().removeprefix("\\ ")


def written(node: ast.expr | None) -> str | None:
    """An annotation as it stands in the source; quotes around all of it are left out."""
    if node is None:
        return None
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    return ast.unparse(node)


def definition(thing: object) -> ast.AST | None:
    """The syntax tree of a class or a function."""
    with contextlib.suppress(OSError, TypeError, SyntaxError):
        source = textwrap.dedent(inspect.getsource(thing))  # pyright: ignore[reportArgumentType]
        return ast.parse(source).body[0]
    return None


def field_types(kind: type) -> dict[str, str]:
    """Annotations of the fields and the types of the properties of a class, its bases' included."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not base.__module__.startswith("petalfit"):
            continue
        tree = definition(base)
        for node in getattr(tree, "body", []):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                found[node.target.id] = written(node.annotation) or ""
    return found


def argument_types(function: object) -> tuple[dict[str, str], str | None]:
    """Annotations of the arguments of a function, and of what it returns."""
    function = inspect.unwrap(getattr(function, "__func__", function))  # pyright: ignore
    tree = definition(function)
    if not isinstance(tree, ast.FunctionDef):
        return {}, None
    every = tree.args
    arguments = [*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg]
    types = {a.arg: written(a.annotation) for a in arguments if a is not None}
    return {name: text for name, text in types.items() if text}, written(tree.returns)


def inherited_attributes(kind: type) -> list[str]:
    """The section *Attributes* of bases that have no page of their own, as lines of napoleon's."""
    from sphinx.ext.napoleon import Config
    from sphinx.ext.napoleon.docstring import GoogleDocstring

    lines: list[str] = []
    for base in kind.__mro__[1:]:
        if base.__name__ in pf.__all__ or not base.__module__.startswith("petalfit"):
            continue
        _, found, section = (inspect.cleandoc(base.__doc__ or "")).partition("Attributes:\n")
        if found:
            config = Config(napoleon_use_ivar=True)
            lines += str(GoogleDocstring("Attributes:\n" + section, config)).splitlines()
    return lines


def parameter_table(kind: type) -> Iterator[str]:
    """The declared parameters, as a table."""
    declared = pf.parameters(kind)
    if not declared:
        return
    model = kind()
    yield from ("", ".. list-table:: Parameters", "   :header-rows: 1", "")
    rows = [("name", "symbol", "default", "unit", "bounds", "typical", "meaning")]
    for name, p in declared.items():
        value = model
        for part in name.split("."):
            value = getattr(value, part)
        meaning = p.meaning + (" (fixed unless named in ``free``)" if p.fixed else "")
        symbol = "" if p.symbol == name else p.symbol.replace("_", r"\_")
        spans = p.bounds, p.typical
        span = [f"{low:g}\N{NO-BREAK SPACE}…\N{NO-BREAK SPACE}{high:g}" for low, high in spans]
        span = [text.replace("-", "−") for text in span]
        rows.append((f"``{name}``", symbol, f"{float(value):g}", p.unit, *span, meaning))
    for row in rows:
        for k, cell in enumerate(row):
            yield f"   {'* -' if k == 0 else '  -'} {cell}"
    yield ""


def markup(lines: list[str]) -> list[str]:
    """Docstrings as the reference wants them: names in backticks linked or literal, bars as they are."""
    done, literal = [], None
    for line in lines:
        indent = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indent <= literal:
            literal = None
        if literal is None:
            line = re.sub(
                r"(?<![:`\w])`([^`<>]+)`(?!`|_)",
                lambda found: public_link(found[1]) or f"``{found[1]}``",
                line,
            )
            # A bar opens a substitution, where the text means a modulus.
            line = re.sub(r"(``.*?``|:py:obj:`.*?`)|\|", lambda m: m[1] or r"\|", line)
            if line.rstrip().endswith("::") and not line.lstrip().startswith(".."):
                literal = indent
        done.append(line)
    return done


# Of a property's "Of the distances: pixels" napoleon makes a type and a description.
_properties: dict[str, list[str]] = {}


def keep_properties(
    app: object, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Before napoleon: what a property says, as it says it."""
    if isinstance(thing, property):
        _properties[name] = list(lines)


def process(app: object, what: str, name: str, thing: object, options: object, lines: list) -> None:
    """Everything of the above, for autodoc."""
    lines[:] = _properties.pop(name, lines)
    types: dict[str, str] = {}
    returns: str | None = None
    if inspect.isclass(thing):
        lines += inherited_attributes(thing)
        types = field_types(thing)
    elif callable(thing) or isinstance(thing, property):
        types, returns = argument_types(thing.fget if isinstance(thing, property) else thing)
    typed: list[str] = []
    for line in markup(lines):
        typed.append(line)
        field = re.match(r"(\s*):(param|ivar) (\\?\*{0,2}[^:]+?):", line)
        if field and (key := field[3].replace("\\", "").strip("*")) in types:
            kind = "type" if field[2] == "param" else "vartype"
            # Before the description, which may go on in the lines that follow.
            typed.insert(-1, f"{field[1]}:{kind} {field[3]}: {as_type(types[key])}")
    if returns not in (None, "None") and not isinstance(thing, property):
        fields = [k for k, line in enumerate(typed) if re.match(r":(raises|returns)", line)]
        line = f":rtype: {as_type(returns)}"
        if fields:
            typed.insert(fields[0], line)
        else:
            typed += ["", line, ""] if not any(re.match(r":param", t) for t in typed) else [line]
    if isinstance(thing, property) and returns:
        typed += ["", f":type: {as_type(returns)}"]
    if inspect.isclass(thing) and thing.__name__ in pf.__all__ and hasattr(thing, "__mro__"):
        with contextlib.suppress(TypeError):
            typed += parameter_table(thing)
    lines[:] = typed


def signature(app, what, name, thing, options, text, returns):
    """Of a class whose parameters have a table, nothing; no types anywhere."""
    with contextlib.suppress(TypeError):
        if inspect.isclass(thing) and pf.parameters(thing):
            return "(**parameters)", None
    return text, None


class CommandHelp(Directive):
    """The help of every command, as it prints it: a section each."""

    def run(self) -> list[nodes.Node]:
        return [self.section(name) for name in commands()]

    def section(self, name: str) -> nodes.Node:
        section = nodes.section(ids=[f"petalfit-{name}"], names=[f"petalfit {name}"])
        section += nodes.title("", f"petalfit {name}")
        text = help_of(name)
        block = nodes.literal_block(text, text)
        block["language"] = "text"
        section += block
        self.state.document.note_implicit_target(section)
        return section


def commands() -> list[str]:
    """The names of all commands."""
    from petalfit.cli import main

    found: dict = {}

    def keep(commands: dict, **_: object) -> int:
        found.update(commands)
        return 0

    with mock.patch.object(tyro.extras, "subcommand_cli_from_dict", keep):
        main(["--help"])
    return list(found)


def help_of(name: str) -> str:
    """What `petalfit NAME --help` prints on 88 columns."""
    from petalfit.cli import main

    told = io.StringIO()
    with (
        mock.patch.dict(os.environ, COLUMNS="88", NO_COLOR="1"),
        contextlib.redirect_stdout(told),
        contextlib.suppress(SystemExit),
    ):
        main([name, "--help"])
    return re.sub(r"\x1b\[[0-9;]*m", "", told.getvalue()).rstrip()


def setup(app) -> dict[str, bool]:
    app.add_directive("command-help", CommandHelp)
    app.connect("autodoc-process-docstring", keep_properties, priority=400)
    # After napoleon, which connects with the usual priority.
    app.connect("autodoc-process-docstring", process, priority=900)
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True}
