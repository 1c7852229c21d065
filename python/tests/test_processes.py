"""Farms in several processes."""

import multiprocessing
import pathlib
import pickle
import threading
import time

import pytest

import resin_farm
from conftest import GRID

# A farm that waits without end must not hang its test.
SOON = 60.0


def medium(farm: resin_farm.Farm, white: resin_farm.Measurement) -> resin_farm.Medium:
    return farm.fit(white, dictionary="grid", g=0.4)["R"].medium


def names(dictionary: resin_farm.Dictionary) -> tuple[str, list[str]]:
    assert isinstance(dictionary._farm, resin_farm.Farm)
    return dictionary.refresh().name, [d.name for d in dictionary._farm.dictionaries()]


def refusal(farm: resin_farm.Farm) -> str:
    try:
        farm.dictionaries()
    except resin_farm.FarmError as error:
        return error.message
    return "an answer"


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_farm_opens_itself_anew_in_another_process(
    farm: resin_farm.Farm, white: resin_farm.Measurement, method: str
) -> None:
    dictionary = farm.dictionary("grid")
    with multiprocessing.get_context(method).Pool(2) as pool:
        found = [pool.apply_async(medium, (farm, white)) for _ in range(4)]
        asked = pool.apply_async(names, (dictionary,))
        assert [one.get(SOON) for one in found] == [medium(farm, white)] * 4
        name, all_names = asked.get(SOON)
        assert name == dictionary.name and name in all_names
    assert farm.dictionaries(), "it is closed by those who found it"


def test_a_farm_that_was_connected_to_is_pickled_as_its_address(farm: resin_farm.Farm) -> None:
    connected = resin_farm.Farm.connect(farm.address)
    again = pickle.loads(pickle.dumps(connected))
    assert again.address == farm.address and again.dictionaries()
    again.close()
    connected.close()


def test_a_fork_beside_a_busy_thread_is_refused_with_a_sentence(
    farm: resin_farm.Farm, white: resin_farm.Measurement
) -> None:
    stop = threading.Event()

    def busy() -> None:
        while not stop.is_set():
            medium(farm, white)

    thread = threading.Thread(target=busy)
    thread.start()
    context = multiprocessing.get_context("fork")
    try:
        for _ in range(8):
            with context.Pool(1) as pool:
                message = pool.apply_async(refusal, (farm,)).get(SOON)
                assert "spawn" in message and "fork" in message, message
    finally:
        stop.set()
        thread.join()


def test_a_fork_does_not_keep_a_farm_alive(tmp_path: pathlib.Path) -> None:
    context = multiprocessing.get_context("fork")
    hold = context.Event()
    with resin_farm.Farm(tmp_path) as farm:
        farm.submit(GRID, "grid", wait=False)
        child = context.Process(target=hold.wait)
        child.start()
    end = time.monotonic() + SOON
    while (tmp_path / "coordinator.addr").exists():
        assert time.monotonic() < end, "the farm outlives its program"
        time.sleep(0.1)
    hold.set()
    child.join()
