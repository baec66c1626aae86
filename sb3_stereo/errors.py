"""The one exception for wrong user input, and its one-sentence message."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

MAX_LENGTH = 2000  # of a sentence, in characters
MAX_NAME = 100  # of a name that is unknown; ours are shorter


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
    given = str(name) if len(str(name)) <= MAX_NAME else f"{str(name)[:MAX_NAME]}…"
    close = difflib.get_close_matches(given, choices, n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    return ConfigError(f"unknown {what} '{given}'{hint}; allowed are: {', '.join(choices) or 'none'}")


@contextmanager
def setting_up(what: str, error_class: type[ConfigError] = ConfigError) -> Iterator[None]:
    """Turn whatever is raised while something is set up into the user's error, in one sentence.

    What the user chose is first put together here, by constructors of ours, SB3's, torch's and of packages that the
    user named. Ours raise a ValueError that says what is allowed; others raise anything. What is raised later, when
    everything has been set up, is a bug and stays as it is.

    Args:
        what: What is set up, for the sentence.
        error_class: What is raised.

    Raises:
        ConfigError: If anything but a signal is raised; `error_class`, unless it was a ConfigError of another kind.
    """
    try:
        yield
    except ConfigError as error:
        raise error if type(error) is not ConfigError else error_class(str(error)) from error
    except MemoryError as error:
        raise error_class(f"not enough memory to set up {what} ({_reason(error)}); make it smaller") from error
    except OSError as error:
        raise error_class(f"cannot set up {what}: {_reason(error)}") from error
    except ValueError as error:
        raise error_class(str(error) or f"{what} is refused without a reason") from error
    except Exception as error:
        reason = f"{type(error).__name__}: {_reason(error)}"
        way_out = "change its settings, or see where it happened with --verbose 2"
        raise error_class(f"cannot set up {what} ({reason}); {way_out}") from error


def _reason(error: Exception) -> str:
    """What an exception says, without the advice and the stack that C++ adds."""
    lines = str(error).strip().splitlines()
    return lines[0] if lines else "no reason given"
