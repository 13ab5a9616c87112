"""One studio for the tests of a module, in a folder of its own."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phytac_design.studio.server import StudioServer
from tests.studio.place import DESIGN, Client, studio


@pytest.fixture(scope="package")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("place")


@pytest.fixture(scope="package")
def running(place: Path) -> Iterator[StudioServer]:
    with studio(place) as own:
        yield own


@pytest.fixture(scope="package")
def client(running: StudioServer) -> Client:
    return Client(running)


@pytest.fixture
def data() -> dict[str, Any]:
    return tomllib.loads(DESIGN)
