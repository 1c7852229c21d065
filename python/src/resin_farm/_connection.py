"""Makes calls to a coordinator."""

from __future__ import annotations

import os
import pathlib
import socket
import stat
import sys
import tomllib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import grpc

from resin_farm import errors

Answer = TypeVar("Answer")

# Limit of a message in bytes, for answers about whole dictionaries; the coordinator's limit is smaller.
_LARGEST = 256 << 20

# Pings detect links that were cut without a reset.
_KEEPALIVE_MS = 20_000

# Codes with which proxies, and the transport itself, end a stream.
_CUT = (
    grpc.StatusCode.CANCELLED,
    grpc.StatusCode.INTERNAL,
    grpc.StatusCode.UNKNOWN,
    grpc.StatusCode.RESOURCE_EXHAUSTED,
)

# The process that uses gRPC; its forks cannot.
_process: int | None = None


class Connection:
    """A channel to a coordinator. Every failed call is one of this package's exceptions."""

    def __init__(self, channel: grpc.Channel, address: str) -> None:
        self._channel = channel
        self.address = address
        self._closed = False

    def call(self, method: str, request: Any, answer: Callable[[bytes], Answer], timeout_s: float | None) -> Answer:
        """One request, one answer; `method` as in "Fits/Fit"."""
        not_in_a_fork()
        made: Callable[..., Answer] = self._channel.unary_unary(
            f"/farm.v1.{method}",
            request_serializer=lambda message: message.SerializeToString(),
            response_deserializer=answer,
        )
        try:
            return made(request, timeout=timeout_s)
        except grpc.RpcError as error:
            raise errors.of_call(error) from None
        except ValueError:
            raise self._unless_closed() from None

    def stream(
        self, method: str, request: Any, answer: Callable[[bytes], Answer], timeout_s: float
    ) -> Iterator[Answer]:
        """One request, many answers."""
        not_in_a_fork()
        made: Callable[..., Iterator[Answer]] = self._channel.unary_stream(
            f"/farm.v1.{method}",
            request_serializer=lambda message: message.SerializeToString(),
            response_deserializer=answer,
        )
        try:
            yield from made(request, timeout=timeout_s)
        except grpc.RpcError as error:
            found = errors.of_call(error)
            if isinstance(error, grpc.Call) and error.code() in _CUT:
                found = errors.Unavailable(found.message)
            raise found from None
        except ValueError:
            raise self._unless_closed() from None

    def _unless_closed(self) -> BaseException:
        """The exception that is being handled; another thread may have found that the farm has gone."""
        handled = sys.exception()
        if not self._closed and handled is not None:
            return handled
        return errors.Unavailable(f"the connection to {self.address} was closed")

    def answers(self) -> bool:
        """Whether the other end answers."""
        if self._closed:
            return False
        ready = grpc.channel_ready_future(self._channel)
        try:
            ready.result(timeout=1)
        except grpc.FutureTimeoutError:
            return False
        finally:
            ready.cancel()
        return True

    def close(self) -> None:
        self._closed = True
        self._channel.close()


def not_in_a_fork() -> None:
    """gRPC does not survive a fork: its threads are the parent's, and a call would wait for them for ever.

    Raises:
        FarmError: in a fork of a process that has used gRPC.
    """
    global _process
    _process = _process or os.getpid()
    if _process != os.getpid():
        raise errors.FarmError(
            f"process {_process} has opened a farm, and this one ({os.getpid()}) is a fork of it, where gRPC does not "
            'work: use multiprocessing.get_context("spawn") or "forkserver", where a Farm opens itself again'
        )


def of_loopback(url: str) -> Connection:
    """A coordinator without an access file. That of this user is reached by its Unix socket; another one by its port,
    unless another user of this machine listens on it."""
    address = url.removeprefix("http://").rstrip("/")
    port = address.rpartition(":")[2]
    if _is_loopback(address):
        if path := _socket(port):
            # HTTP/2 needs the name of a host, which a path is not.
            options = [*_options(address), ("grpc.default_authority", "localhost")]
            return Connection(grpc.insecure_channel(f"unix:{path}", options), url)
        for owner in _listeners(int(port)) - {os.geteuid(), 0}:
            raise errors.Refused(f"port {port} is held by another user of this machine (number {owner})")
    return Connection(grpc.insecure_channel(address, _options(address)), url)


def _socket(port: str) -> pathlib.Path | None:
    """The socket of this user's coordinator on a port, in a folder that is closed to others."""
    user = os.geteuid()
    folders = [f"/run/user/{user}/resin-farm", f"/tmp/resin-farm-{user}"]
    for folder in map(pathlib.Path, [given] if (given := os.environ.get("FARM_SOCKETS")) else folders):
        try:
            about = folder.lstat()
            closed = stat.S_ISDIR(about.st_mode) and about.st_uid == user and not about.st_mode & 0o077
            with socket.socket(socket.AF_UNIX) as trial:
                # A coordinator that was killed leaves its socket's name.
                trial.connect(str(folder / port))
        except OSError:
            continue
        if closed:
            return folder / port
    return None


def _listeners(port: int) -> set[int]:
    """The users whose programs listen on a port of this machine, if the kernel has a table of them."""
    owners = set()
    for table in map(pathlib.Path, ("/proc/net/tcp", "/proc/net/tcp6")):
        for line in table.read_text("ascii").splitlines()[1:] if table.exists() else []:
            _, local, _, state, *_, owner = line.split()[:8]
            if state == "0A" and int(local.rpartition(":")[2], 16) == port:
                owners.add(int(owner))
    return owners


def of_access_file(path: pathlib.Path) -> Connection:
    """The coordinator that an access file names, by TLS."""
    with open(path, "rb") as file:
        access = tomllib.load(file)
    for key in ("server", "ca_certificate", "token"):
        if key not in access:
            raise errors.FarmError(f"{path}: {key} is missing; an access file is made by `farmctl access create`")
    # The key and the certificate are present only if the coordinator requires them.
    keys = [access[name].encode() if name in access else None for name in ("ca_certificate", "key", "certificate")]
    credentials = grpc.composite_channel_credentials(
        grpc.ssl_channel_credentials(*keys), grpc.access_token_call_credentials(access["token"])
    )
    address = access["server"].removeprefix("https://").rstrip("/")
    options = _options(address)
    if name := access.get("server_name"):
        options.append(("grpc.ssl_target_name_override", name))
    return Connection(grpc.secure_channel(address, credentials, options), access["server"])


def _is_loopback(address: str) -> bool:
    return address.rpartition(":")[0] in ("127.0.0.1", "localhost", "[::1]")


def _options(address: str) -> list[tuple[str, Any]]:
    options = [("grpc.max_receive_message_length", _LARGEST), ("grpc.max_send_message_length", _LARGEST)]
    options += [("grpc.keepalive_time_ms", _KEEPALIVE_MS), ("grpc.keepalive_timeout_ms", _KEEPALIVE_MS)]
    options.append(("grpc.http2.max_pings_without_data", 0))
    # A second channel to an address would otherwise use the connection of the first, which may lead nowhere.
    options.append(("grpc.use_local_subchannel_pool", 1))
    if _is_loopback(address) or address.startswith("unix:"):
        # A proxy would connect to its own machine's loopback, or see the token.
        options.append(("grpc.enable_http_proxy", 0))
    return options
