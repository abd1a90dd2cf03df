"""What the package raises. Every message is the one that the program or the service gives."""

from __future__ import annotations

from typing import Any, Mapping


class Error(Exception):
    """Base class of the errors of this package."""


class Refused(Error):
    """The service understood the request and refused it; the message says why, and what to do."""


class BadRequest(Error):
    """The request is invalid: an unknown value, one out of range, or a pose out of reach."""


class Unreachable(Error):
    """No service answers: it is not running, hangs, has closed the connection, or is no service of retroflex."""


class NotSettled(Error):
    """The tip has not settled at its target.

    `status` is the status of the service at that time.
    """

    def __init__(self, message: str, status: Mapping[str, Any]) -> None:
        super().__init__(message)
        self.status = status


class LogError(Error):
    """A log cannot be read; the message names the file and, where there is one, the line and the column."""


class ProgramError(Error):
    """The program `retroflex` has failed or is not installed.

    `code` is its exit code: 2 for bad input, 3 if it cannot be started.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code
