"""Numbers as text for people: rounded to what is known, with a true minus sign."""

from __future__ import annotations

import math
from collections.abc import Sequence

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MOST_DECIMALS = 9


def plain(value: float, digits: int = 3) -> str:
    """A number with this many significant digits, for instance 0.0501 or −1.23 × 10⁻⁷."""
    if not math.isfinite(value):
        return "not a number" if math.isnan(value) else "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, exponent = f"{abs(value):.{digits - 1}e}".split("e")
    power = int(exponent)
    sign = "−" if value < 0 else ""
    if -4 <= power < digits + 3:
        return sign + f"{float(f'{mantissa}e{power}'):.{max(digits - 1 - power, 0)}f}"
    return f"{sign}{mantissa} × 10{str(power).translate(_SUPERSCRIPT)}"


def fixed(value: float, decimals: int) -> str:
    """A number with this many decimals; a zero has no minus sign."""
    if not math.isfinite(value):
        return plain(value)
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def decimals_of(error: float) -> int:
    """The number of decimals that shows an error, and the value it belongs to, to two digits."""
    if not (math.isfinite(error) and error > 0):
        return 6
    power = int(f"{error:.1e}".split("e")[1])
    return min(max(1 - power, 0), _MOST_DECIMALS)


def measured(value: float, error: float) -> tuple[str, str]:
    """A value and its standard error with the same decimals, such that the error has two digits."""
    decimals = decimals_of(error)
    small = math.isfinite(error) and error < 10.0 ** (1 - decimals) / 2
    return fixed(value, decimals), plain(error, 2) if small else fixed(error, decimals)


def count(number: int, noun: str) -> str:
    """A number with its noun, as in "1 point" or "1,500 points"."""
    return f"{number:,} {noun}" + ("s" if number != 1 else "")


def listed(names: Sequence[str]) -> str:
    """Names in a list, as in "a, b and c"."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers in a range: multiples of 1, 2 or 5 times a power of ten.

    Args:
        low: The lower end of the range.
        high: The upper end of the range, above `low`.
        most: The largest number of ticks, at least 2.
    """
    step = round_up((high - low) / most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def round_up(length: float) -> float:
    """The least number of the form 1, 2 or 5 times a power of ten that is not below `length`."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= length * (1 - 1e-9))


def share(drawn: int, total: int) -> str:
    """A phrase that says how many of all points are shown."""
    if drawn == total:
        return f"all {count(total, 'point')}" if total != 1 else "the only point"
    return f"{drawn:,} of {count(total, 'point')}, chosen at random,"
