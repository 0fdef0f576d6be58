"""petalfit: flowers from a few named numbers, and the numbers back from a target.

Names are imported when they are first used: `import petalfit` costs milliseconds, not jax.
"""

import lazy_loader

from petalfit.version import VERSION as __version__  # noqa: F401

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
