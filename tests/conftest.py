"""A built small sensor, made once for the whole run, in a cache of its own."""

import os

# As the command line does, before numpy loads (see ``phytac_design.cli``).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

from phytac_design.build import BuildResult, build
from tests.designs import small


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests neither use nor fill the user's cache."""
    patch = pytest.MonkeyPatch()
    patch.setenv("PHYTAC_CACHE", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory, own_cache: None) -> BuildResult:
    """The small design, built whole at draft accuracy."""
    out = tmp_path_factory.mktemp("exports") / "small"
    return build(small(), out, accuracy="draft", progress=lambda _: None)
