"""The exception that unusable input raises."""


class TargetError(ValueError):
    """A target that cannot be used.

    The message says in one or two sentences what was wrong, what was expected and what to do.
    """
