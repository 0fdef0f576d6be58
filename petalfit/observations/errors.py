"""The one exception that unusable input raises."""


class TargetError(ValueError):
    """What was given to fit cannot be used.

    The message says in a sentence or two what was wrong, what was expected and what to do.
    """
