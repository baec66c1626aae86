"""The one error that a user's input raises, and the sentence it says."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

MAX_LENGTH = 2000  # of a sentence, in characters


class ConfigError(ValueError):
    """Wrong input: the value, what is allowed and the way out, in one sentence.

    What it quotes may come from anywhere, see `one_line`.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))


def one_line(sentence: str) -> str:
    """Return a sentence for a terminal: control characters written out, the middle of a very long one left out."""
    plain = "".join(char if char.isprintable() else repr(char)[1:-1] for char in sentence)
    if len(plain) <= MAX_LENGTH:
        return plain
    return f"{plain[: MAX_LENGTH // 2]} … {plain[-MAX_LENGTH // 2 :]}"


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


@contextmanager
def refusals_are_errors() -> Iterator[None]:
    """Turn the ValueErrors of constructors, which say what is allowed, into the user's error."""
    try:
        yield
    except ValueError as error:
        raise ConfigError(str(error)) from error
