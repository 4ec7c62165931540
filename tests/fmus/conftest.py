"""FMUs are compiled once a session, in a cache of their own."""

import pytest

from fmus.cache import CACHE_VARIABLE


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
    yield
    patch.undo()


@pytest.fixture(params=["2", "3"], ids=["fmi2", "fmi3"])
def fmi(request):
    """Version of the standard."""
    return request.param
