"""The errors a user can cause or meet; each message names the culprit and what would be right."""


class PsmpcError(Exception):
    """Root of all errors this package raises on purpose. `exit_code` is what the command line returns."""

    exit_code = 2


class SpecError(PsmpcError):
    """A robot or task description does not hold; the message lists every problem, one a line."""


class InputError(PsmpcError):
    """A flag, path or argument is wrong."""


class LogError(PsmpcError):
    """A file is not a log this version can read."""


class RunError(PsmpcError):
    """A run could not go on; the reason is the message."""

    exit_code = 3
