"""Every test runs with petalfit's shapes and types checked as it goes."""

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

from tests.browser import browser as browser

# Before anything imports petalfit: what is imported earlier stays unchecked.
install_import_hook("petalfit", "beartype.beartype")

# Compilation makes a first example slow, so no deadlines; CI tries the same examples every time.
settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


@pytest.fixture(autouse=True, scope="session")
def programs_in_common(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What one process has compiled the others load: those that run tests, and those that tests start."""
    from petalfit.compilation.cache import VARIABLE, compilation_cache

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, str(folder / "cache"))
        with compilation_cache():
            yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take longest come first, so that no process is left alone with one of them."""
    items.sort(key=lambda item: item.path.name not in _LONGEST)


_LONGEST = {"test_documentation.py", "test_silhouettes.py"}
