"""Run by Jupyter before a notebook of the documentation: warnings are errors, and programs are kept."""

import warnings

from petalfit.compilation.cache import compilation_cache

# Kept alive by its name: a generator that is collected closes its block.
_programs = compilation_cache()
_programs.__enter__()

warnings.filterwarnings("error", module="(petalfit|pictures|__main__|jax|numpy|matplotlib)")
