"""The exceptions of this package."""

from __future__ import annotations

import grpc
from google.rpc import error_details_pb2  # type: ignore[import-untyped]
from grpc_status import rpc_status


class FarmError(Exception):
    """The farm, or one of its programs, could not fulfil a request; `message` is the text."""

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.message = message


class InvalidArgument(FarmError, ValueError):
    """A value is out of its range; `fields` names each, with what is allowed."""

    def __init__(self, message: str, fields: dict[str, str] | None = None) -> None:
        super().__init__(message)
        self.fields = fields or {}


class NotInstalled(FarmError, FileNotFoundError):
    """A program of the farm is not there."""


class NotFound(FarmError, LookupError):
    """There is no dictionary of this name."""


class Deleted(NotFound):
    """The dictionary was deleted, or replaced by another one of its name, while it was waited for."""


class Refused(FarmError):
    """The farm refuses this call to the token, or the state of a dictionary does not allow it."""


class Unavailable(FarmError):
    """The farm does not answer, or did not in time."""


def of_call(error: grpc.RpcError) -> FarmError:
    """The exception for a failed call."""
    # Errors that grpc raises for failed calls are calls themselves.
    if not isinstance(error, grpc.Call):
        return FarmError(str(error))
    code, message = error.code(), error.details() or ""
    if code == grpc.StatusCode.INVALID_ARGUMENT:
        return InvalidArgument(message, _fields(error))
    if code == grpc.StatusCode.NOT_FOUND:
        return NotFound(message)
    if code in (
        grpc.StatusCode.PERMISSION_DENIED,
        grpc.StatusCode.UNAUTHENTICATED,
        grpc.StatusCode.FAILED_PRECONDITION,
        grpc.StatusCode.ALREADY_EXISTS,
    ):
        return Refused(message)
    if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED):
        return Unavailable(message)
    return FarmError(f"{code.name}: {message}")


def _fields(call: grpc.Call) -> dict[str, str]:
    status = rpc_status.from_call(call)
    found: dict[str, str] = {}
    for detail in status.details if status is not None else []:
        bad = error_details_pb2.BadRequest()
        if detail.Unpack(bad):
            found.update({violation.field: violation.description for violation in bad.field_violations})
    return found
