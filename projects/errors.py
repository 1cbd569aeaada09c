"""The errors that a user can cause or meet; each message says what was given, what is allowed and what to do.

Only the command line catches `MonitorError`: one line on stderr, exit code 2.
"""


class MonitorError(Exception):
    """Base of every error that this toolkit raises on purpose."""


class ShapeError(MonitorError):
    """An array has the wrong shape, type or content."""


class ParameterError(MonitorError):
    """A value lies outside of what is allowed."""


class FormatError(MonitorError):
    """A file cannot be read as what it claims to be."""


class UnitError(FormatError):
    """A file's unit is improbable or was not stated."""


class StoreError(MonitorError):
    """The project store is missing, locked, damaged or lacks what was asked for."""


class RegistrationError(MonitorError):
    """A registration failed, is ambiguous, or was not good enough to build on."""


class ReconstructionError(MonitorError):
    """No surface can be made of the points given."""


class ComparisonError(MonitorError):
    """Two epochs cannot be compared, with the reason."""
