"""Warnings as data: reasons to doubt a result, each with a kind, parameters and a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from petalfit.results.meaning import WithMeaning


class WarningKind(WithMeaning):
    """The kind of a warning. Each member is the string that files hold.

    Attributes:
        meaning: The explanation of the kind, in one sentence.
    """

    TARGET = "target", "The data are odd, or were mended when they were read."
    NOT_DETERMINED = "not_determined", "The target does not determine a parameter."
    AT_BOUND = "at_bound", "A parameter ended at the bound of its range."
    COMBINATION = "combination", "Only a combination of parameters is determined."
    RIVALS = "rivals", "Other starts ended elsewhere, almost as well."
    FLIPS = "flips", "The parameters still move by a small part of their errors."
    NOISE = "noise", "Distances are larger than the noise that was given."
    OUTLIERS = "outliers", "Some points lie far beyond the typical distance."
    COVERAGE = "coverage", "Part of the surface has no data near it."
    SYSTEMATIC = (
        "systematic",
        "Distances have a pattern: the model cannot follow all of the target.",
    )
    RELATIVE_LENGTHS = "relative_lengths", "Without a camera, lengths have no unit."
    NO_PATTERN = "no_pattern", "The texture shows no pattern of the kind that was fitted."
    COUNT = "count", "Another number of petals is nearly as likely."
    LEFT_OUT = "left_out", "Some of the cloud belongs to no petal."
    CONTRAST = "contrast", "What a pattern leaves unexplained is large beside its contrast."
    COLOURS = "colours", "The texture has more than two colours and their mixtures."


class FitWarning(str):
    """One reason to doubt a result: a sentence, which is the string itself, with its kind.

    Programs use the kind and the parameters; people read the sentence.

    Attributes:
        kind: The kind of the warning.
        parameters: Names of the parameters that it concerns; empty if it concerns all of them.
    """

    kind: WarningKind
    parameters: tuple[str, ...]

    def __new__(
        cls, text: str, kind: WarningKind | str, parameters: Iterable[str] = ()
    ) -> FitWarning:
        """Makes a warning.

        Args:
            text: The whole sentence.
            kind: The kind of the warning.
            parameters: Names of the parameters that it concerns.
        """
        warning = super().__new__(cls, text)
        warning.kind = WarningKind(kind)
        warning.parameters = tuple(parameters)
        return warning

    def __getnewargs__(self) -> tuple[str, str, tuple[str, ...]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return str(self), str(self.kind), self.parameters

    @property
    def text(self) -> str:
        """The whole sentence."""
        return str(self)

    @property
    def parameter(self) -> str | None:
        """The parameter that it concerns, if that is a single one."""
        return self.parameters[0] if len(self.parameters) == 1 else None

    @property
    def about(self) -> str:
        """The sentence without the name of the parameter that it begins with, for a table's row."""
        return self.text.removeprefix(f"{self.parameter} ")

    def to_json(self) -> dict[str, Any]:
        """The warning as JSON holds it."""
        return {"kind": str(self.kind), "parameters": [*self.parameters], "text": self.text}

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> FitWarning:
        """The warning that `to_json` described."""
        return cls(content["text"], content["kind"], content["parameters"])


def one_of_each(warnings: Iterable[FitWarning]) -> Iterator[tuple[str, list[str]]]:
    """Groups warnings that say the same about different parameters.

    Each group is what is said, and the names of the parameters. Warnings about no single parameter come
    first, with an empty list.
    """
    of_parameters: dict[str, list[str]] = {}
    for warning in warnings:
        if warning.parameter is None:
            yield warning.text, []
        else:
            of_parameters.setdefault(warning.about, []).append(warning.parameter)
    yield from of_parameters.items()
