"""A farm with a small dictionary around the media of examples/white.csv."""

import os
import pathlib
from collections.abc import Iterator

import pytest

import resin_farm

CHECKOUT = pathlib.Path(os.environ["FARM_CHECKOUT"])
WHITE = CHECKOUT / "examples" / "white.csv"
GRID = resin_farm.Grid(
    sigma_t_per_mm=[5, 6, 7, 8, 9, 10, 20, 24, 28],
    albedo=[0.998, 0.999, 0.9995, 0.9999],
    g=[0.3, 0.4],
    thickness_mm=[0.5, 1],
    walks=10_000,
)


@pytest.fixture(scope="session")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[resin_farm.Farm]:
    with resin_farm.Farm(tmp_path_factory.mktemp("farm")) as farm:
        farm.submit(GRID, progress=False)
        yield farm


@pytest.fixture(scope="session")
def white() -> resin_farm.Measurement:
    (material,) = resin_farm.read_measurements(WHITE)
    return material
