"""How a command ends: exit statuses, and the exception for options that it cannot follow."""

SUCCESS = 0
UNUSABLE = 2
NOT_CONVERGED = 3
INTERRUPTED = 130
BROKEN_PIPE = 141


class CommandError(Exception):
    """An option, or a place to write to, that cannot be used; exit status `UNUSABLE`.

    The message is a sentence for the terminal: what was wrong, and what to do.
    """


def require(condition: bool, sentence: str) -> None:
    """Raises a `CommandError` with this sentence unless the condition holds."""
    if not condition:
        raise CommandError(sentence)
