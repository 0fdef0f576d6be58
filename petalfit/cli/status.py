"""Exit statuses of commands, and the exception for options that cannot be used."""

SUCCESS = 0
UNUSABLE = 2
NOT_CONVERGED = 3
INTERRUPTED = 130
BROKEN_PIPE = 141


class CommandError(Exception):
    """An option or an output path that cannot be used; its exit status is `UNUSABLE`.

    The message is a sentence for the terminal, on what was wrong and what to do.
    """


def require(condition: bool, sentence: str) -> None:
    """Raises a `CommandError` with this sentence unless the condition holds."""
    if not condition:
        raise CommandError(sentence)
