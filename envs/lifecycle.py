"""What an environment has from its first `reset` to its `close`."""

from typing import Any, Generic, TypeVar

from gymnasium.error import ClosedEnvironmentError, ResetNeeded

Value = TypeVar("Value")


class Lasting(Generic[Value]):
    """An attribute that is there while the environment's simulator is, or while an episode is.

    Whoever asks for it too early or too late is told so. It costs nothing in between: Python asks a descriptor without
    `__set__` only where the object itself lacks the attribute.

    Raises:
        ClosedEnvironmentError: If the environment has been closed, and so has no `_world` any more.
        ResetNeeded: If it is open and the attribute comes with the first `reset`.
    """

    def __get__(self, env: Any, owner: type | None = None) -> Value:
        if "_world" not in vars(env):
            raise ClosedEnvironmentError("the environment is closed; make a new one")
        raise ResetNeeded("the environment has no episode yet; call reset first")
