"""One studio for the tests of a module, in a folder of its own."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phytac_design.studio.server import Running
from tests.studio.place import DESIGN, Client, studio


@pytest.fixture(scope="package")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("place")


@pytest.fixture(scope="package")
def running(place: Path) -> Iterator[Running]:
    with studio(place) as own:
        yield own


@pytest.fixture(scope="package")
def client(running: Running) -> Client:
    return Client(running)


@pytest.fixture
def data() -> dict[str, Any]:
    return tomllib.loads(DESIGN)
