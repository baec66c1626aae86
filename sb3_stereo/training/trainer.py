"""Train an agent into a run directory, and resume an interrupted run."""

import shutil
import warnings
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.callback import OnEvaluation
from sb3_stereo.runs import snapshots, status, tensorboard
from sb3_stereo.runs.creation import create_run
from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.files import refuse_links
from sb3_stereo.runs.rollback import restore_files
from sb3_stereo.runs.training_state import State
from sb3_stereo.training.errors import Refused, losses_are_errors
from sb3_stereo.training.options import Options, Result, recorded_options
from sb3_stereo.training.session import Session
from sb3_stereo.training.signals import interruptions


def train(
    config: Config,
    options: Options,
    record: Mapping[str, Any] | None = None,
    on_evaluation: OnEvaluation | None = None,
) -> Result:
    """Train, evaluate and save an agent.

    SIGINT and SIGTERM end the training early; the model is saved all the same, and `resume` goes on from the last
    snapshot.

    Args:
        config: What to learn, and how.
        options: How to run it.
        record: Further arguments of the command, for the run's `args.yml`.
        on_evaluation: Called with the run directory after every evaluation but the last.

    Raises:
        ConfigError: If the environment or the model refuses its arguments, the disk is full, or a process that steps
            an environment died.
    """
    with interruptions() as signals:
        run, folder = _new_run(config, options, record or {})
        try:
            with status.locked(run), losses_are_errors(run):
                return Session(run, config, options, folder, on_evaluation=on_evaluation).train(signals)
        except Refused:
            for made in [run, *([folder] if folder else [])]:
                shutil.rmtree(made, ignore_errors=True)  # it has nothing in it yet
            raise


def _new_run(config: Config, options: Options, record: Mapping[str, Any]) -> tuple[Path, Path | None]:
    """Make and return the directory of a run, and its folder for TensorBoard."""
    with tensorboard.new_folder(options.tensorboard_log, config) as folder:
        args = {**record, "algo": config.algo, "env": config.env_id, **asdict(options)}
        args["tensorboard"] = str(folder) if folder else None
        if options.trained_agent:
            args["trained_agent"] = str(Path(options.trained_agent).absolute())  # the training may go on elsewhere

        def claim(run: Path) -> None:
            if folder is not None:
                tensorboard.give(folder, run)

        return create_run(options.log_folder, config, args, claim=claim), folder


def resume(run: Path, verbose: int = 1, on_evaluation: OnEvaluation | None = None) -> Result:
    """Go on with a training that was killed or interrupted, with its own settings, from its last snapshot.

    With the same seed, on a CPU with one thread, it ends as it would have without the interruption, bit for bit.

    Args:
        run: The run directory.
        verbose: As in `Options`.
        on_evaluation: As in `train`.

    Raises:
        ConfigError: If there is no such run, it has ended, or another process trains it.
    """
    config, args = load_record(run)
    options = replace(recorded_options(args), verbose=verbose)
    refuse_links(run)  # before anything in it is opened for writing
    with interruptions() as signals, status.locked(run), losses_are_errors(run):
        if status.has_ended(run, config):  # not before: another process may just have brought it to its end
            snapshots.remove(run)  # it may have been killed just before
            raise ConfigError(f"'{run}' has ended after {config.n_timesteps} steps; there is nothing to resume")
        state = snapshots.newest(run)
        folder = tensorboard.folder_of(run, args.get("tensorboard"))
        if folder is not None:
            refuse_links(folder)
        _roll_back(run, state, folder)
        return Session(run, config, options, folder, state, on_evaluation).train(signals)


def _roll_back(run: Path, state: State | None, folder: Path | None) -> None:
    """Bring a run's directory, and its folder for TensorBoard, back to where a state was captured."""
    status.mark(run, status.NEW)  # runs of before version 0.1.0 have none
    for leftover in run.rglob("*.partial*"):
        leftover.unlink()  # of a file that was not written to its end
    step = state["step"] if state else 0
    snapshots.remove(run, after=step)
    restore_files(run, state["files"] if state else None, step)
    if folder is None:
        return
    if folder.parent == run and not folder.is_dir():
        warnings.warn(
            f"'{run}' was copied or moved; its TensorBoard files from here on are in '{folder}'", stacklevel=3
        )
    elif lost := tensorboard.restore_events(folder, state["events"] if state else {}):
        warnings.warn(f"in '{folder}' something is missing of: {', '.join(lost)}", stacklevel=3)
