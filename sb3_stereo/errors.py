"""The one error that a user's input raises, and the sentence it says."""

import difflib
from collections.abc import Iterable


class ConfigError(ValueError):
    """Wrong input: the value, what is allowed and the way out, in one sentence."""


def unknown(what: str, name: object, allowed: Iterable[str]) -> ConfigError:
    """Return the error for a name that is not among the allowed ones.

    Args:
        what: What the name stands for, e.g. "algorithm".
        name: The name that was given.
        allowed: The names that exist.
    """
    choices = sorted(allowed)
    close = difflib.get_close_matches(str(name), choices, n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    return ConfigError(f"unknown {what} '{name}'{hint}; allowed are: {', '.join(choices) or 'none'}")
