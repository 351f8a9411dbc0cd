"""What loose-env raises when it is asked for something it cannot do."""


class LooseEnvError(Exception):
    """Base of every error raised by loose-env."""


class InvalidSetting(LooseEnvError, ValueError):
    """A setting lies outside what is allowed."""


class UnknownName(LooseEnvError, ValueError):
    """A name is none of those that exist."""


class InvalidAction(LooseEnvError, ValueError):
    """An action lies outside the action space."""


class MissingExtra(LooseEnvError, ImportError):
    """An optional package is needed and not installed."""


class InvalidData(LooseEnvError, ValueError):
    """Measured data has a shape, a length or values that cannot be used."""
