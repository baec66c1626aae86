"""Life cycle of an environment from the first `reset` to `close`: what is allowed when, saved states, copies."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, NoReturn, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from sb3_stereo.envs.capture import Capture, Floats
from sb3_stereo.envs.composite import Observation
from sb3_stereo.envs.world import World

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


@dataclass(frozen=True, eq=False)
class SavedState:
    """What `save_state` returns: the key of the world's state, and what the environment remembers besides."""

    attributes: Mapping[str, Any]

    @property
    def target_position(self) -> Floats:
        """Of the target, shape (3,), in [m], world."""
        target: Floats = self.attributes["_target_position"]
        return target


class SimulatedEnv(gym.Env[Observation, NDArray[np.float32]]):
    """An environment in a `World`, of which a copy is a world of its own (see there).

    The constructor makes the world; `reset` sets what comes with an episode.
    """

    _world: Lasting[World] = Lasting()
    _target_position: Lasting[Floats] = Lasting()
    _captured: Lasting[Capture] = Lasting()
    _of_episode: tuple[str, ...] = ("_target_position", "_captured")  # attributes that a saved state has

    def close(self) -> None:
        """Disconnect from Bullet; a second call does nothing."""
        attributes = vars(self)
        if "_world" in attributes:
            self._world.close()
        for name in ("_world", *self._of_episode):
            attributes.pop(name, None)

    def save_state(self) -> SavedState:
        """Everything that the coming steps depend on. Free it with `remove_state`."""
        state = SavedState({name: getattr(self, name) for name in self._of_episode})
        self._world.save(state)
        return state

    def restore_state(self, state: SavedState) -> None:
        """Go back to a saved state, exactly; it may be restored any number of times.

        Raises:
            ValueError: If another environment saved it, or it is removed.
        """
        self._world.restore(state)
        vars(self).update(state.attributes)

    def remove_state(self, state: SavedState) -> None:
        """Free a saved state.

        Raises:
            ValueError: If another environment saved it, or it is removed.
        """
        self._world.remove(state)

    def __copy__(self) -> NoReturn:
        raise ValueError("a shallow copy of an environment would share its simulator; use copy.deepcopy")

    @contextmanager
    def _unchanged_by_errors(self) -> Iterator[None]:
        """Take back what was done if an error is raised within: to the world, to attributes, and random draws."""
        attributes, random = vars(self).copy(), self._np_random
        draws = None if random is None else random.bit_generator.state
        try:
            with self._world.unchanged_by_errors():
                yield
        except BaseException:
            vars(self).clear()
            vars(self).update(attributes)
            if random is not None and draws is not None:
                random.bit_generator.state = draws
            raise
