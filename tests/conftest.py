"""Every test runs with petalfit's shapes and types checked as it goes."""

import os

from hypothesis import settings
from jaxtyping import install_import_hook

# Before anything imports petalfit: what is imported earlier stays unchecked.
install_import_hook("petalfit", "beartype.beartype")

# Compilation makes a first example slow, so no deadlines; CI tries the same examples every time.
settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")
