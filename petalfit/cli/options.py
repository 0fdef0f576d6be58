"""Options that several commands share, and checks of their values."""

import math
from typing import Annotated

from tyro.conf import arg

from petalfit.cli.status import CommandError, require

Quiet = Annotated[bool, arg(help="Print warnings only.")]


def setting_value(setting: str, name: str, text: str, example: str) -> float:
    """The number in `--set NAME=VALUE`; the error for other text shows an example."""
    try:
        return float(text)
    except ValueError:
        sentence = f"--set {setting} gives no number; write --set {name}={example}."
        raise CommandError(sentence) from None


def require_noise(noise: float, *, least: str = "0 or more") -> None:
    """Raises an error unless `noise` is a standard deviation; `least` says in words whether 0 is one."""
    good = math.isfinite(noise) and (noise > 0 or (noise == 0 and least == "0 or more"))
    require(good, f"--noise {noise:g} is no standard deviation; give {least}.")


def require_seed(seed: int) -> None:
    """Raises an error for a negative seed, which NumPy does not accept."""
    require(seed >= 0, f"--seed {seed} is negative; give 0 or more.")


def names_of(given: tuple[str, ...]) -> list[str] | None:
    """The names in options that may be repeated or separate names by commas; None without any."""
    if not given:
        return None
    return [name for text in given for name in text.replace(",", " ").split()]
