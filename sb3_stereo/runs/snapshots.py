"""Snapshots from which an interrupted training run resumes: complete files, the last two of them.

They are called `checkpoints/step_2000-3f9ab1d2….pt`, with the beginning of the SHA-256 of their bytes, as PyTorch Hub
names its files. (A checkpoint in SB3's sense is a model alone, `rl_model_2000_steps.zip`.)
"""

import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch as th
from stable_baselines3.common.callbacks import BaseCallback

from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import checkpoint_name
from sb3_stereo.runs.files import publish, sha256
from sb3_stereo.runs.models import is_whole, save_model
from sb3_stereo.runs.rollback import capture_files
from sb3_stereo.runs.snapshot_file import FORMAT, read_snapshot
from sb3_stereo.runs.training_state import State, capture, restore, restore_drawn

FOLDER = "checkpoints"
N_KEPT = 2  # should the newest be damaged, there is the one before
MISFITS = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
_NAME = re.compile(r"step_(\d+)-([0-9a-f]{16})\.pt")


def save(run: Path, step: int, state: State) -> Path:
    """Write a snapshot and remove those before the last two.

    Raises:
        OSError: If it cannot be written, for example because the disk is full; the earlier ones stay. With torch's
            writer it may be the context of a RuntimeError.
    """
    folder = run / FOLDER
    partial = folder / "partial"
    folder.mkdir(exist_ok=True)
    try:
        with partial.open("wb") as file:  # torch hides the reason when it opens the file itself
            th.save({"format": FORMAT, "step": step, **state}, file)
        path = folder / f"step_{step}-{sha256(partial)[:16]}.pt"
        publish(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    for old in _paths(run)[N_KEPT:]:
        old.unlink()
    return path


def newest(run: Path) -> State | None:
    """Return the state of a run's newest snapshot that is whole, None if there is none; warns of damaged ones.

    Raises:
        ConfigError: If it is none of this version's.
    """
    for path in _paths(run):
        if sha256(path)[:16] == _match(path)[2]:
            return read_snapshot(path)
        warnings.warn(f"'{path}' is damaged: its digest is another one; trying the snapshot before it", stacklevel=2)
    return None


def _paths(run: Path) -> list[Path]:
    """The snapshots of a run, the newest first."""
    paths = [path for path in (run / FOLDER).glob("*.pt") if _NAME.fullmatch(path.name) and path.is_file()]
    return sorted(paths, key=lambda path: (int(_match(path)[1]), path.stat().st_mtime), reverse=True)


def _match(path: Path) -> re.Match[str]:
    match = _NAME.fullmatch(path.name)
    assert match is not None
    return match


def remove(run: Path, after: int = -1) -> None:
    """Remove the snapshots of a run, and the folder if nothing else is in it.

    Args:
        run: The run directory.
        after: Only those of later steps: all that are damaged, once the training goes on from an earlier one.
    """
    for path in _paths(run):
        if int(_match(path)[1]) > after:
            path.unlink()
    (run / FOLDER / "partial").unlink(missing_ok=True)
    if (run / FOLDER).is_dir() and not any((run / FOLDER).iterdir()):
        (run / FOLDER).rmdir()


class SaveSnapshots(BaseCallback):
    """Saves model and training every `save_freq` steps, between two rollouts, and begins from a state if given one.

    The model comes before the snapshot, so that no training goes on behind a model that is missing.

    It is the last callback: the others must have been set up before they get their state back.

    Args:
        run: The run directory.
        save_freq: Environment steps between snapshots; not positive saves none.
        callbacks: The other callbacks of the training.
        event_sizes: Returns how large TensorBoard's files are.
        state: To begin from.
    """

    def __init__(
        self,
        run: Path,
        save_freq: int,
        callbacks: Sequence[BaseCallback],
        event_sizes: Callable[[], Mapping[str, int]] = dict,
        state: State | None = None,
    ) -> None:
        super().__init__()
        self.run, self.save_freq, self.callbacks, self.event_sizes = run, save_freq, callbacks, event_sizes
        self.state = state
        self.saved = 0

    def _on_training_start(self) -> None:
        if self.state is not None:
            with self._misfits_are_errors():
                restore(self.model, self.callbacks, self.state["training"])
            if not is_whole(self.run / checkpoint_name(self.model.num_timesteps)):
                self._save_model(self.model.num_timesteps)
        self.saved = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.state is not None:
            with self._misfits_are_errors():
                restore_drawn(self.model, self.state["training"])
            self.state = None  # it is as large as the replay buffer
        step = self.model.num_timesteps
        if self._is_due(step):
            self._save_model(step)
            training = capture(self.model, self.callbacks)
            files, events = capture_files(self.run), dict(self.event_sizes())
            save(self.run, step, {"training": training, "files": files, "events": events})

    @contextmanager
    def _misfits_are_errors(self) -> Iterator[None]:
        """Say of a state that is not the one of such a training that it is not."""
        try:
            yield
        except ConfigError:
            raise
        except MISFITS as error:
            reason = (str(error).strip() or type(error).__name__).splitlines()[0]
            what = f"the snapshot of step {self.state and self.state['step']} in '{self.run / FOLDER}'"
            way_out = "remove it, and the one before it is used"
            raise ConfigError(f"{what} does not go with the run's settings ({reason}); {way_out}") from error

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        if self._is_due(self.model.num_timesteps):
            self._save_model(self.model.num_timesteps)

    def _is_due(self, step: int) -> bool:
        return self.save_freq > 0 and step // self.save_freq > self.saved // self.save_freq

    def _save_model(self, step: int) -> None:
        save_model(self.model, self.run / checkpoint_name(step))
        self.saved = step
