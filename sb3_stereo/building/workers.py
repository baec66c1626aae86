"""Environments in worker processes, and what happens when one of these dies."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import wait

from stable_baselines3.common.vec_env import VecEnv

from sb3_stereo.errors import ConfigError

LOST = (EOFError, ConnectionError)  # what a pipe to a dead process raises; the second is also a closed terminal's
PATIENCE = 5.0  # [s], from the end of a pipe to the end of its process


class WorkerDied(ConfigError):
    """A process that steps an environment is gone.

    Attributes:
        what: The sentence without its way out.
    """

    def __init__(self, cause: str) -> None:
        self.what = f"a process that steps an environment died ({cause})"
        super().__init__(f"{self.what}; see that there is memory for all of them, and try again")


@contextmanager
def deaths_are_errors(env: VecEnv) -> Iterator[None]:
    """Turn what a dead process of the environment's makes of its pipe into a `WorkerDied`."""
    try:
        yield
    except LOST as error:
        cause = _cause_of_death(env)
        if cause is None:
            raise
        raise WorkerDied(cause) from error


def close(env: VecEnv) -> None:
    """Close the environments; if one of their processes has died, end the others."""
    try:
        env.close()
    except LOST:
        for process in getattr(env, "processes", ()):
            process.terminate()
            process.join()
        for remote in getattr(env, "remotes", ()):
            remote.close()


def _cause_of_death(env: VecEnv) -> str | None:
    """Say how the first dead process ended; None if all live, or there is none."""
    processes = getattr(env, "processes", ())
    wait([process.sentinel for process in processes], timeout=PATIENCE if processes else 0.0)
    codes = [process.exitcode for process in processes if process.exitcode is not None]
    if not codes:
        return None
    return signal.Signals(-codes[0]).name if codes[0] < 0 else f"exit status {codes[0]}"
