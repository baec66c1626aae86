"""Checkpoints from which a killed training goes on: whole files, the last two of them.

They are called `checkpoints/step_2000-3f9ab1d2….pt`, with the beginning of the SHA-256 of their bytes, as PyTorch Hub
names its files.
"""

import pickle
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import torch as th
from stable_baselines3.common.callbacks import BaseCallback

from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import CHECKPOINT_PREFIX, how_to_resume
from sb3_stereo.runs.files import publish, sha256, sizes
from sb3_stereo.runs.models import save_model
from sb3_stereo.runs.training_state import State, capture, restore, restore_drawn

FOLDER = "checkpoints"
N_KEPT = 2  # should the newest be damaged, there is the one before
_NAME = re.compile(r"step_(\d+)-([0-9a-f]{16})\.pt")


def save(run: Path, step: int, state: State) -> Path:
    """Write a checkpoint and remove those before the last two.

    Raises:
        ConfigError: If it cannot be written, for example because the disk is full; the earlier ones stay.
    """
    folder = run / FOLDER
    partial = folder / "partial"
    try:
        folder.mkdir(exist_ok=True)
        with partial.open("wb") as file:  # torch hides the reason when it opens the file itself
            th.save(state, file)
        path = folder / f"step_{step}-{sha256(partial)[:16]}.pt"
        publish(partial, path)
    except (OSError, RuntimeError) as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(
            f"cannot write a checkpoint to '{folder}' ({_reason(error)}); make room, then {how_to_resume(run)}"
        ) from error
    for old in _paths(run)[N_KEPT:]:
        old.unlink()
    return path


def _reason(error: BaseException) -> str:
    """What the system said, which torch's error hides."""
    cause = error
    while cause.__context__ is not None and not isinstance(cause, OSError):
        cause = cause.__context__
    return cause.strerror or str(cause) if isinstance(cause, OSError) else str(error).splitlines()[0]


def newest(run: Path) -> State | None:
    """Return the state of a run's newest checkpoint that is whole, None if there is none; warns of damaged ones."""
    for path in _paths(run):
        if sha256(path)[:16] == _match(path)[2]:
            return _load(path)
        warnings.warn(f"'{path}' is damaged: its digest is another one; trying the checkpoint before it", stacklevel=2)
    return None


def _load(path: Path) -> State:
    try:
        state: State = th.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        way_out = "remove it, and the one before it is used"
        raise ConfigError(f"'{path}' holds more than plain data, which is not loaded; {way_out}") from error
    return state


def _paths(run: Path) -> list[Path]:
    """The checkpoints of a run, the newest first."""
    paths = [path for path in (run / FOLDER).glob("*.pt") if _NAME.fullmatch(path.name)]
    return sorted(paths, key=lambda path: (int(_match(path)[1]), path.stat().st_mtime), reverse=True)


def _match(path: Path) -> re.Match[str]:
    match = _NAME.fullmatch(path.name)
    assert match is not None
    return match


def remove(run: Path) -> None:
    """Remove the checkpoints of a run that has ended."""
    for path in (run / FOLDER).glob("*"):
        path.unlink()
    if (run / FOLDER).is_dir():
        (run / FOLDER).rmdir()


class Checkpoint(BaseCallback):
    """Saves the training every `save_freq` steps, between two rollouts, and begins from a saved state if given one.

    It is the last callback: the others must have been set up before they get their state back.

    Args:
        run: The run directory.
        save_freq: Environment steps between checkpoints; not positive saves none.
        callbacks: The other callbacks of the training.
        logs: Files that grow with the training, by a function, since some come into being later.
        state: To begin from.
    """

    def __init__(
        self,
        run: Path,
        save_freq: int,
        callbacks: Sequence[BaseCallback],
        logs: Callable[[], Iterable[Path]],
        state: State | None = None,
    ) -> None:
        super().__init__()
        self.run, self.save_freq, self.callbacks, self.logs = run, save_freq, callbacks, logs
        self.state = state
        self.saved = 0

    def _on_training_start(self) -> None:
        if self.state is not None:
            restore(self.model, self.callbacks, self.state["training"])
        self.saved = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.state is not None:
            restore_drawn(self.model, self.state["training"])
            self.state = None  # it is as large as the replay buffer
        step = self.model.num_timesteps
        if self._is_due(step):
            save(self.run, step, {"training": capture(self.model, self.callbacks), "logs": sizes(self.logs())})
            self._save_model(step)

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        if self._is_due(self.model.num_timesteps):
            self._save_model(self.model.num_timesteps)

    def _is_due(self, step: int) -> bool:
        return self.save_freq > 0 and step // self.save_freq > self.saved // self.save_freq

    def _save_model(self, step: int) -> None:
        save_model(self.model, self.run / f"{CHECKPOINT_PREFIX}_{step}_steps.zip")
        self.saved = step
