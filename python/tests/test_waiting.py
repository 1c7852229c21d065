"""Waiting for a dictionary survives failures of the coordinator, and of the connection to it."""

import logging
import os
import pathlib
import select
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import pytest

import resin_farm
from resin_farm import _programs

SMALL = resin_farm.Grid(sigma_t_per_mm=[4, 8], albedo=[0.9], g=[0.0], thickness_mm=[1], walks=5000)
OTHER = resin_farm.Grid(sigma_t_per_mm=[4], albedo=[0.8], g=[0.0], thickness_mm=[1], walks=5000)
SOON = 30.0


def until(what: str, look: Callable[[], bool]) -> None:
    end = time.monotonic() + SOON
    while not look():
        assert time.monotonic() < end, what
        time.sleep(0.05)


class Link:
    """A proxy from one port to another; connections can be frozen, as by a router that loses their state."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._frozen: set[socket.socket] = set()
        self.refuses = False
        self._ends: list[tuple[socket.socket, socket.socket]] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def freeze(self) -> None:
        self._frozen = {end for ends in self._ends for end in ends}

    def close(self) -> None:
        self._listener.close()
        for end in (end for ends in self._ends for end in ends):
            end.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            if self.refuses:
                client.close()
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                client.close()
                continue
            self._ends.append((client, server))
            threading.Thread(target=self._pass_on, args=(client, server), daemon=True).start()

    def _pass_on(self, client: socket.socket, server: socket.socket) -> None:
        try:
            while True:
                for end in select.select([client, server], [], [])[0]:
                    read = end.recv(1 << 16)
                    if client in self._frozen:
                        # Neither end is notified.
                        return
                    if not read:
                        client.close()
                        server.close()
                        return
                    (server if end is client else client).sendall(read)
        except (OSError, ValueError):
            client.close()
            server.close()


class Server:
    """A coordinator on a free port, which it keeps over restarts."""

    def __init__(self, data: pathlib.Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self._data = data
        self.worker: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        listen = ["--listen", f"127.0.0.1:{self.port}", "--insecure", "--data", str(self._data)]
        environment = os.environ | {"FARM_LOG": "off"}
        self.process = subprocess.Popen([_programs.program("farm-coordinator"), *listen], env=environment)
        until("the coordinator listens", self._listens)

    def _listens(self) -> bool:
        with socket.socket() as there:
            return there.connect_ex(("127.0.0.1", self.port)) == 0

    def work(self) -> None:
        where = ["--server", f"http://127.0.0.1:{self.port}", "--threads", "1"]
        environment = os.environ | {"FARM_LOG": "off"}
        self.worker = subprocess.Popen([_programs.program("farm-worker"), *where], env=environment)

    def close(self) -> None:
        for process in filter(None, (self.worker, self.process)):
            process.terminate()
            process.wait()


@pytest.fixture
def server(tmp_path: pathlib.Path) -> Iterator[Server]:
    server = Server(tmp_path / "data")
    yield server
    server.close()


@pytest.fixture
def link(server: Server, monkeypatch: pytest.MonkeyPatch) -> Iterator[Link]:
    monkeypatch.setattr("resin_farm._access._STREAM_S", 2.0)
    link = Link(server.port)
    yield link
    link.close()


@pytest.fixture
def waiting(link: Link, caplog: pytest.LogCaptureFixture) -> Iterator[Future[resin_farm.Dictionary]]:
    caplog.set_level(logging.WARNING, "resin_farm")
    farm = resin_farm.Farm.connect(link.url)
    dictionary = farm.submit(SMALL, "small", wait=False)
    began = threading.Event()
    stream = farm._stream

    def noticed(*arguments: Any) -> Iterator[Any]:
        for one in stream(*arguments):
            began.set()
            yield one

    farm._stream = noticed  # type: ignore[assignment, method-assign]
    found: Future[resin_farm.Dictionary] = Future()

    def wait() -> None:
        try:
            found.set_result(dictionary.wait(progress=False))
        except resin_farm.FarmError as error:
            found.set_exception(error)

    # A wait that never ends must not hang the test.
    threading.Thread(target=wait, daemon=True).start()
    assert began.wait(SOON)
    yield found
    farm.close()


def test_a_link_that_is_dead_without_a_word_is_left(
    server: Server, link: Link, waiting: Future[resin_farm.Dictionary], caplog: pytest.LogCaptureFixture
) -> None:
    link.freeze()
    until("it is logged", lambda: "does not answer and is waited for" in caplog.text)
    until("it is logged", lambda: "answers again" in caplog.text)
    server.work()
    assert waiting.result(SOON).state == "done"


def test_a_coordinator_that_is_killed_and_comes_back_is_waited_for(
    server: Server, waiting: Future[resin_farm.Dictionary], caplog: pytest.LogCaptureFixture
) -> None:
    server.process.send_signal(signal.SIGKILL)
    server.process.wait()
    until("it is logged", lambda: "does not answer and is waited for" in caplog.text)
    server.start()
    until("it is logged", lambda: "answers again" in caplog.text)
    server.work()
    assert waiting.result(SOON).records_done == 2


def test_another_grid_of_the_same_name_is_not_waited_for(
    server: Server, link: Link, waiting: Future[resin_farm.Dictionary], caplog: pytest.LogCaptureFixture
) -> None:
    # So that the wait receives no state in between.
    link.refuses = True
    link.freeze()
    until("it is logged", lambda: "does not answer and is waited for" in caplog.text)
    farm = resin_farm.Farm.connect(f"http://127.0.0.1:{server.port}")
    replace(farm)
    farm.close()
    link.refuses = False
    with pytest.raises(resin_farm.Deleted, match="small was deleted, or replaced"):
        waiting.result(SOON)


def replace(farm: resin_farm.Farm) -> None:
    dictionary = farm.dictionary("small")
    dictionary.cancel()
    dictionary.delete()
    farm.submit(OTHER, "small", wait=False)
