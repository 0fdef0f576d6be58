"""Warnings as data: reasons to doubt a result, each with a kind, parameters and a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from petalfit.results.meaning import WithMeaning


class WarningKind(WithMeaning):
    """The kind of a warning, those that matter most first. Each member is the string that files hold.

    Attributes:
        meaning: The explanation of the kind, in one sentence.
    """

    TARGET = "target", "The data are odd, or were mended when they were read."
    COVERAGE = "coverage", "Part of the surface has no data near it."
    OUTLIERS = "outliers", "Some points lie far beyond the typical distance."
    RIVALS = "rivals", "Other starts ended elsewhere, almost as well."
    NOISE = "noise", "Distances are larger than the noise that was given."
    SYSTEMATIC = (
        "systematic",
        "Distances have a pattern: the model cannot follow all of the target.",
    )
    NO_PATTERN = "no_pattern", "The texture shows no pattern of the kind that was fitted."
    COUNT = "count", "Another number of petals is nearly as likely."
    LEFT_OUT = "left_out", "Some of the cloud belongs to no petal."
    CONTRAST = "contrast", "What a pattern leaves unexplained is large beside its contrast."
    COLOURS = "colours", "The texture has more than two colours and their mixtures."
    RELATIVE_LENGTHS = "relative_lengths", "Without a camera, lengths have no unit."
    NOT_DETERMINED = "not_determined", "The target does not determine a parameter."
    AT_BOUND = "at_bound", "A parameter ended at the bound of its range."
    COMBINATION = "combination", "Only a combination of parameters is determined."
    FLIPS = "flips", "The parameters still move by a small part of their errors."


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


_ORDER = {kind: k for k, kind in enumerate(WarningKind)}


def in_order(warnings: Iterable[FitWarning]) -> tuple[FitWarning, ...]:
    """Warnings in the order of their kinds, those that matter most first, without repetitions."""
    return tuple(sorted(dict.fromkeys(warnings), key=lambda warning: _ORDER[warning.kind]))


def in_few_words(warnings: Iterable[FitWarning], free: Sequence[str]) -> list[str]:
    """The warnings in few sentences: one for all that say the same about different parameters.

    Args:
        warnings: The warnings.
        free: Names of the free parameters, out of which those that are not determined are counted.
    """
    said: dict[tuple[WarningKind, str], list[FitWarning]] = {}
    for warning in in_order(warnings):
        alike = warning.parameter is not None or warning.kind is WarningKind.COMBINATION
        said.setdefault((warning.kind, "" if alike else warning.text), []).append(warning)
    return [_in_one(kind, group, free) for (kind, _), group in said.items()]


def _in_one(kind: WarningKind, group: list[FitWarning], free: Sequence[str]) -> str:
    """One sentence for warnings of one kind."""
    first, *others = group
    if not others:
        return first.text
    if kind is WarningKind.COMBINATION:
        return f"{first}, and there are {len(others)} more such combinations"
    names = [name for warning in group for name in warning.parameters]
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    if kind is WarningKind.AT_BOUND:
        return f"{listed} ended at the bounds of their ranges"
    about = first.about.removeprefix("is ")
    if len(names) == len(free) and set(names) == set(free):
        return f"none of the {len(free)} parameters is {about.removeprefix('not ')}"
    of = f" of {len(free)}" if set(names) < set(free) else ""
    return f"{len(names)}{of} parameters are {about}: {listed}"
