"""Runs a farm of this machine in a separate process, which ends with this one."""

from __future__ import annotations

import json
import os
import pathlib
import subprocess
import tempfile
import time
import weakref
from typing import IO

from resin_farm import _connection, _programs
from resin_farm.errors import FarmError, Unavailable

_PATIENCE_S = 20.0


class LocalFarm:
    """Keeps `farmctl serve` running, which serves the folder, or finds the process that serves it already."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        self._start()

    def _start(self) -> None:
        # Its standard input is a pipe from this process, so that it ends with this process, however that ends.
        command = [_programs.program("farmctl"), "--json", "--quiet", "--local", "--data", str(self.folder)]
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
            self.address = self._started(command, errors)

    def _started(self, command: list[str], errors: IO[str]) -> str:
        """The address of the process, once it serves the folder; it writes to a file what it reports."""
        self._process = subprocess.Popen(
            [*command, "serve", "--until-input-ends"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            encoding="utf-8",
            # Ctrl-C signals this process only, which then ends the other one.
            process_group=0,
        )
        self._finalizer = weakref.finalize(self, _end, self._process)
        _running.add(self)
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line or json.loads(line)["kind"] != "serve":
            _end(self._process)
            errors.seek(0)
            why = json.loads(line)["data"]["message"] if line else errors.read().strip()
            raise FarmError(f"the farm of {self.folder} does not start: {why}")
        return str(json.loads(line)["data"]["address"])

    def connection(self) -> _connection.Connection:
        return _connection.of_loopback(self.address)

    def find_again(self) -> _connection.Connection:
        """Connects again after the process that served the folder has ended or was killed."""
        gone, end = self.address, time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            if self._process.poll() is not None:
                self._start()
            try:
                self.address = "http://" + (self.folder / "coordinator.addr").read_text(encoding="utf-8").strip()
            except FileNotFoundError:
                self.address = gone
            if self.address != gone:
                return self.connection()
            time.sleep(0.1)
        raise Unavailable(f"the farm of {self.folder} does not answer at {gone}")

    def close(self) -> None:
        self._finalizer()


def _let_go() -> None:
    """Releases the farms in a fork, since only the process that started a farm may hold its standard input open."""
    for farm in _running:
        farm._finalizer.detach()
        if farm._process.stdin is not None:
            farm._process.stdin.close()


_running: weakref.WeakSet[LocalFarm] = weakref.WeakSet()
os.register_at_fork(after_in_child=_let_go)


def _end(process: subprocess.Popen[str]) -> None:
    if process.stdin is not None:
        try:
            process.stdin.close()
        except OSError:
            pass
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


def folder_of(path: str | os.PathLike[str]) -> pathlib.Path:
    return pathlib.Path(path).expanduser().resolve()
