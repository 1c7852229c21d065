"""Opens a farm, makes calls to it, and reconnects after it has gone."""

from __future__ import annotations

import logging
import pathlib
import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Self, TypeVar

from google.protobuf.message import Message

from resin_farm import _connection
from resin_farm._local import LocalFarm
from resin_farm.errors import FarmError, Unavailable

Answer = TypeVar("Answer", bound=Message)

# Without a handler its warnings go to standard error.
_log = logging.getLogger("resin_farm")

# Time limits of calls in seconds: of most, and of those that may read a large database or fit a million pixels.
_CALL_S = 300.0
_PATIENT_S = 12 * 3600.0
_PATIENT = ("Fits/Fit", "Fits/Map", "Fits/Measure", "Dictionaries/Delete")
# Seconds after which a stream is requested again, to detect a dead link even if a proxy answers its pings.
_STREAM_S = 60.0
_PAUSE_S = 1.0
# Seconds in which a coordinator that is shutting down rejects calls.
_ABOUT_TO_END = 2.0


class FarmAccess:
    """A farm of this machine by its folder, or one by its URL or access file. Its calls survive a restart of a farm."""

    def _begin(self, folder: pathlib.Path | None, where: str | None) -> None:
        """A farm by its folder, or by its URL or access file; it is opened by its first call."""
        self._folder = folder
        self._where = where
        self._local: LocalFarm | None = None
        self._connection: _connection.Connection | None = None
        self._closed = False
        # Several threads may find that the farm has gone: one of them reconnects.
        self._looking = threading.Lock()

    @property
    def address(self) -> str:
        """The URL of the coordinator."""
        return (self._connection or self._open()).address

    def close(self) -> None:
        """Ends a farm of this machine, if this program started it; dictionaries in progress continue with the next."""
        self._closed = True
        if self._connection is not None:
            self._connection.close()
        if self._local is not None:
            self._local.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Farm({str(self._folder or self._where)!r})"

    def _arguments(self) -> list[str]:
        """The arguments that select this farm in farmctl."""
        if self._where is not None and not self._where.startswith("http://"):
            return ["--access", self._where]
        return ["--server", self.address]

    def _call(self, method: str, request: Message, answer: type[Answer]) -> Answer:
        connection, timeout_s = self._open(), _PATIENT_S if method in _PATIENT else _CALL_S
        try:
            return connection.call(method, request, answer.FromString, timeout_s)
        except Unavailable:
            if self._local is None:
                raise
        if connection.answers():
            # It is shutting down, or refuses the call for a reason that the second try reports.
            time.sleep(_ABOUT_TO_END)
            try:
                return connection.call(method, request, answer.FromString, timeout_s)
            except Unavailable:
                if connection.answers():
                    raise
        self._find_again(connection)
        return self._open().call(method, request, answer.FromString, timeout_s)

    def _stream(self, method: str, request: Message, answer: type[Answer]) -> Iterator[Answer]:
        """Yields the answers. While the farm does not answer, retries without end, and logs that."""
        away = False
        while True:
            connection, begun, came = self._open(), time.monotonic(), False
            try:
                for one in connection.stream(method, request, answer.FromString, _STREAM_S):
                    if away:
                        _log.warning("%r answers again", self)
                    away, came = False, True
                    yield one
                return
            except Unavailable as error:
                if came and time.monotonic() - begun >= _STREAM_S:
                    continue
                if not away:
                    _log.warning("%r does not answer and is waited for: %s", self, error.message)
                away = True
            time.sleep(_PAUSE_S)
            if self._local is None or connection.answers():
                self._connect_anew(connection)
                continue
            try:
                self._find_again(connection)
            except Unavailable:
                # A frozen process may continue later.
                continue

    def _open(self) -> _connection.Connection:
        if self._closed:
            raise FarmError(f"{self!r} is closed")
        if self._connection is None:
            with self._looking:
                if self._connection is None:
                    self._connection = self._connect()
        return self._connection

    def _connect(self) -> _connection.Connection:
        _connection.not_in_a_fork()
        if self._folder is not None:
            self._local = LocalFarm(self._folder)
            return self._local.connection()
        where = self._where or ""
        if where.startswith("http://"):
            return _connection.of_loopback(where)
        if where.startswith("https://"):
            raise FarmError(f"{where}: an access file is needed, which holds the certificate that identifies the farm")
        return _connection.of_access_file(pathlib.Path(where))

    def _connect_anew(self, gone: _connection.Connection) -> None:
        """Replaces a connection that may be dead; calls that wait on it are not cancelled."""
        with self._looking:
            if self._connection is gone:
                self._connection = self._local.connection() if self._local else self._connect()

    def _find_again(self, gone: _connection.Connection) -> None:
        """Reconnects after a farm of this machine has gone."""
        with self._looking:
            if self._connection is gone and self._local is not None:
                self._connection = self._local.find_again()
                gone.close()
