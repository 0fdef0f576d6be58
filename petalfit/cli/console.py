"""Output in the terminal: progress, tables and warnings."""

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from petalfit.fitting import FitResult

NOT_DETERMINED = "not determined"


def output() -> Console:
    """The console for results."""
    return _console(stderr=False)


def errors() -> Console:
    """The console for warnings and progress, which must not end up in a file with the results."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    stream = sys.stderr if stderr else sys.stdout
    # Few of the encodings that Windows gives to a pipe contain σ and ±.
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors="replace")  # pyright: ignore[reportAttributeAccessIssue]
    # Names and messages may come from files, so brackets in them are text and no markup.
    return Console(stderr=stderr, highlight=False, markup=False)


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str], None]]:
    """Yields a function that shows the current step; it does nothing outside a terminal.

    Args:
        quiet: Whether to show nothing in a terminal either.

    Yields:
        A function that takes a line of text.
    """
    console = errors()
    if quiet or not console.is_terminal:
        yield lambda text: None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text: bar.update(task, description=text)


def with_error(value: float, error: float) -> tuple[str, str]:
    """A value and its standard error as text, both to two significant digits of the error.

    If the error is infinite or unknown, the value has six digits and the error is empty.
    """
    from petalfit.report.rounding import decimals_of

    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.6g}", ""
    decimals = decimals_of(error)
    return f"{value:.{decimals}f}", f"{error:.{decimals}f}"


def fit_table(result: "FitResult", truth: dict[str, float] | None = None) -> Table:
    """The parameters of a fit with their errors, and what noise alone would make of these.

    Args:
        result: The result of the fit.
        truth: The true values, if known. They add two columns: the truth, and the deviation of the fit
            from it in standard errors.

    Returns:
        A table with a row for each parameter of the model.
    """
    table = Table(header_style="bold")
    # Long cells are folded, because a number that is cut off would be another number.
    table.add_column("parameter", overflow="fold")
    numbers = ["value", "± error"] if truth is None else ["truth", "value", "± error", "off by"]
    if result.discrepancy is not None:
        numbers.append("by noise alone")
    for heading in numbers:
        table.add_column(heading, justify="right", overflow="fold")
    table.add_column("unit", overflow="fold")
    for name, parameter in result.declared.items():
        value = result.values[name]
        error = result.stderr.get(name, math.inf)
        shown, shown_error = with_error(value, error)
        style = None
        if name not in result.names:
            shown_error, style = "fixed", "dim"
        elif not result.identifiable[name]:
            shown_error, style = NOT_DETERMINED, "yellow"
        known = truth is not None and 0 < error < math.inf
        off = f"{abs(value - truth[name]) / error:.1f} σ" if truth is not None and known else ""
        cells = [name, shown, shown_error, "" if parameter.unit == "1" else parameter.unit]
        if result.discrepancy is not None:
            cells[3:3] = [with_error(value, result.stderr_noise.get(name, math.inf))[1]]
        if truth is not None:
            cells[3:3] = [off]
            cells[1:1] = [f"{truth[name]:.6g}"]
        table.add_row(*cells, style=style)
    return table


def traits_table(result: "FitResult") -> Table:
    """What botanists measure, with errors, in the target's unit."""
    table = Table(header_style="bold")
    table.add_column("trait", overflow="fold")
    for heading in ("value", "± error"):
        table.add_column(heading, justify="right", overflow="fold")
    table.add_column("unit", overflow="fold")
    table.add_column("what it is", overflow="fold")
    for name, trait in result.traits.items():
        shown, shown_error = with_error(trait.value, trait.stderr)
        unit = "" if trait.unit == "1" else trait.unit
        table.add_row(name, shown, shown_error or "not known", unit, trait.meaning)
    return table


def summarise(result: "FitResult", noise: float | None) -> str:
    """A line on how well the surface fits, and how the fit ended.

    Args:
        result: The result of the fit.
        noise: The noise that the user gave, if any.
    """
    parts = []
    for part in result.agreements:
        unit = "" if part.unit == "length" else f" {part.unit}"
        given = noise is not None and part.unit == "length"
        parts.append(
            f"{part.target.described}, rms distance {part.rms:.3g}{unit}, noise {part.noise:.3g}{unit} "
            f"({'given' if given else 'estimated'})"
        )
    return "; ".join([*parts, result.outcome, *where_the_time_went(result)])


def where_the_time_went(result: "FitResult") -> list[str]:
    """The seconds of a fit by stage, as a part of a sentence; an empty list if they are unknown."""
    if not result.timings:
        return []
    stages = [f"{stage} {seconds:.2g}" for stage, seconds in result.timings.items()]
    return [f"{sum(result.timings.values()):.2g} s ({', '.join(stages)})"]


def list_files(folder: Path, contents: dict[str, str]) -> None:
    """Prints the paths of the files, and the purpose of each."""
    width = max(len(str(folder / name)) for name in contents)
    for name, what in contents.items():
        line = f"{folder / name!s:<{width}}  {what}"
        output().print(line, soft_wrap=True)


def warn(result: "FitResult") -> None:
    """Prints the doubts that matter most, to the console for errors so that they are seen in any case."""
    console, (first, rest) = errors(), result.doubts_in_two
    if not result.converged:
        sentence = f"{result.outcome}; the files hold what it ended with"
        console.print(Text(f"petalfit: {sentence}", style="bold yellow"), soft_wrap=True)
    warn_of(first, len(rest))


def warn_of(warnings: Iterable[str], more: int = 0) -> None:
    """Prints warnings, and how many more the report holds, to the console for errors."""
    from petalfit.cli.results import REPORT

    console = errors()
    for warning in warnings:
        console.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)
    if more:
        are = "warning is" if more == 1 else "warnings are"
        console.print(Text(f"{more} more {are} in {REPORT}", style="yellow"), soft_wrap=True)
