"""Calls to a coordinator."""

from __future__ import annotations

import os
import pathlib
import tomllib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import grpc

from resin_farm import errors

Answer = TypeVar("Answer")

# Whole dictionaries' answers; the coordinator's own limit is smaller.
_LARGEST = 256 << 20


class Connection:
    """A channel to a coordinator. Every failed call is one of this package's exceptions."""

    def __init__(self, channel: grpc.Channel, address: str) -> None:
        self._channel = channel
        self.address = address

    def call(self, method: str, request: Any, answer: Callable[[bytes], Answer], timeout_s: float | None) -> Answer:
        """One request, one answer; `method` as in "Fits/Fit"."""
        made: Callable[..., Answer] = self._channel.unary_unary(
            f"/farm.v1.{method}",
            request_serializer=lambda message: message.SerializeToString(),
            response_deserializer=answer,
        )
        try:
            return made(request, timeout=timeout_s)
        except grpc.RpcError as error:
            raise errors.of_call(error) from None

    def stream(self, method: str, request: Any, answer: Callable[[bytes], Answer]) -> Iterator[Answer]:
        """One request, many answers."""
        made: Callable[..., Iterator[Answer]] = self._channel.unary_stream(
            f"/farm.v1.{method}",
            request_serializer=lambda message: message.SerializeToString(),
            response_deserializer=answer,
        )
        try:
            yield from made(request)
        except grpc.RpcError as error:
            raise errors.of_call(error) from None

    def answers(self) -> bool:
        """Whether there is somebody at the other end."""
        ready = grpc.channel_ready_future(self._channel)
        try:
            ready.result(timeout=1)
        except grpc.FutureTimeoutError:
            return False
        finally:
            ready.cancel()
        return True

    def close(self) -> None:
        self._channel.close()


def of_loopback(url: str) -> Connection:
    """A coordinator without an access file. One of this machine puts a key into a file which its user's programs can
    read; others let everybody in, or nobody."""
    address = url.removeprefix("http://").rstrip("/")
    host, _, port = address.rpartition(":")
    key = pathlib.Path(f"/tmp/resin-farm-{os.getuid()}", port)
    if host not in ("127.0.0.1", "localhost", "[::1]") or not key.exists():
        return Connection(grpc.insecure_channel(address, _options()), url)
    folder = key.parent.stat()
    if folder.st_uid != os.getuid() or folder.st_mode & 0o077:
        raise errors.Refused(f"{key.parent}: others have a say in this folder, so its key is not used")
    token = grpc.access_token_call_credentials(key.read_text())
    credentials = grpc.composite_channel_credentials(grpc.local_channel_credentials(), token)
    return Connection(grpc.secure_channel(address, credentials, _options()), url)


def of_access_file(path: pathlib.Path) -> Connection:
    """The coordinator that an access file names, by TLS."""
    with open(path, "rb") as file:
        access = tomllib.load(file)
    for key in ("server", "ca_certificate", "token"):
        if key not in access:
            raise errors.FarmError(f"{path}: {key} is missing; an access file is made by `farmctl access create`")
    # The key and the certificate are only there if the coordinator asks for them.
    keys = [access[name].encode() if name in access else None for name in ("ca_certificate", "key", "certificate")]
    credentials = grpc.composite_channel_credentials(
        grpc.ssl_channel_credentials(*keys), grpc.access_token_call_credentials(access["token"])
    )
    options = _options()
    if name := access.get("server_name"):
        options.append(("grpc.ssl_target_name_override", name))
    address = access["server"].removeprefix("https://").rstrip("/")
    return Connection(grpc.secure_channel(address, credentials, options), access["server"])


def _options() -> list[tuple[str, Any]]:
    return [("grpc.max_receive_message_length", _LARGEST), ("grpc.max_send_message_length", _LARGEST)]
