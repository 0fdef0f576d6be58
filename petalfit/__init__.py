"""petalfit grows flowers from a few named numbers, and fits those numbers to a target.

Names are imported when they are first used, so `import petalfit` takes milliseconds and loads no jax.
"""

import lazy_loader

from petalfit.version import VERSION as __version__  # noqa: F401

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
