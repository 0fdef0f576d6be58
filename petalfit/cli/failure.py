"""The one exception that a command raises for options it cannot follow."""


class CommandError(Exception):
    """An option, or a place to write to, that cannot be used.

    The message is a sentence for the terminal: what was wrong, and what to do.
    """


def require(condition: bool, sentence: str) -> None:
    """Raises a `CommandError` with this sentence unless the condition holds."""
    if not condition:
        raise CommandError(sentence)
