"""Words that files and tables hold, each with its meaning in a sentence."""

from __future__ import annotations

import enum
from typing import TypeVar

Word = TypeVar("Word", bound="WithMeaning")


class WithMeaning(enum.StrEnum):
    """An enum whose members are their strings and carry a meaning.

    Attributes:
        meaning: One sentence for people.
    """

    meaning: str

    def __new__(cls: type[Word], value: str, meaning: str) -> Word:
        """A member, declared as its string and its meaning."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.meaning = meaning
        return member
