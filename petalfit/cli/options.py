"""Options that several commands share, and what is required of them."""

import math
from typing import Annotated

from tyro.conf import arg

from petalfit.cli.status import CommandError, require

Quiet = Annotated[bool, arg(help="Print warnings only.")]


def setting_value(setting: str, name: str, text: str, example: str) -> float:
    """The number of a `--set NAME=VALUE`, or a sentence that shows how one is written."""
    try:
        return float(text)
    except ValueError:
        sentence = f"--set {setting} gives no number; write --set {name}={example}."
        raise CommandError(sentence) from None


def require_noise(noise: float, *, least: str = "0 or more") -> None:
    """Refuses what is no standard deviation; `least` says whether 0 is one."""
    good = math.isfinite(noise) and (noise > 0 or (noise == 0 and least == "0 or more"))
    require(good, f"--noise {noise:g} is no standard deviation; give {least}.")


def require_seed(seed: int) -> None:
    """Refuses negative seeds, which NumPy does not take."""
    require(seed >= 0, f"--seed {seed} is negative; give 0 or more.")
