"""Train an agent into a run directory."""

import errno
import shutil
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.logger import configure as configure_logger
from stable_baselines3.common.vec_env import VecEnv

from sb3_stereo.building.factory import make_callbacks, make_env, make_model, make_training_env
from sb3_stereo.building.workers import WorkerDied, close, deaths_are_errors
from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.callback import OnScore, PoseEvalCallback, checkpoints
from sb3_stereo.evaluation.protocol import Evaluation, test_starts
from sb3_stereo.evaluation.tensorboard import TensorboardPictures
from sb3_stereo.runs.directory import (
    EVALUATIONS,
    create_run,
    env_name,
    has_ended,
    how_to_resume,
    load_record,
    locked,
    make_numbered,
    save_records,
)
from sb3_stereo.runs.files import cut_back
from sb3_stereo.runs.models import load_weights, save_model
from sb3_stereo.runs.snapshots import Checkpoint, newest
from sb3_stereo.runs.snapshots import remove as remove_checkpoints
from sb3_stereo.runs.training_state import State
from sb3_stereo.training.progress import Progress
from sb3_stereo.training.signals import signals_ignored, signals_interrupt

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Refused(ConfigError):
    """A training that did not begin."""


@dataclass(frozen=True)
class Options:
    """How to run a training; none of these changes what is learnt, except the seed.

    Attributes:
        seed: Seeds environments, networks and noise.
        log_folder: Where the run directory is made.
        eval_freq: 0 scores at the paper's checkpoints, a positive number every so many steps, a negative one only at
            the end.
        n_eval_envs: Environments that are stepped together in a score.
        save_freq: A checkpoint every so many environment steps; not positive saves none.
        tensorboard_log: Folder for TensorBoard; None writes nothing.
        device: PyTorch device.
        vec_env: "dummy" or "subproc".
        trained_agent: A saved model whose networks and optimizers to begin with.
        trust: Begin with a model that has no checksum, too.
        progress: True draws a bar, False prints lines, None decides by the terminal.
        verbose: 0 is silent, 1 shows progress and scores, 2 also SB3's tables.
    """

    seed: int
    log_folder: str = "logs"
    eval_freq: int = 0
    n_eval_envs: int = 1
    save_freq: int = -1
    tensorboard_log: str | None = None
    device: str = "auto"
    vec_env: str = "dummy"
    trained_agent: str | None = None
    trust: bool = False
    progress: bool | None = None
    verbose: int = 1


@dataclass(frozen=True)
class Result:
    """What a training leaves.

    Attributes:
        run: The run directory.
        n_timesteps: Environment steps taken.
        evaluation: The last score; None if there was none.
        interrupted: The signal that ended the training early, e.g. "SIGINT"; None if none did.
    """

    run: Path
    n_timesteps: int
    evaluation: Evaluation | None
    interrupted: str | None


def train(
    config: Config, options: Options, record: Mapping[str, Any] | None = None, on_score: OnScore | None = None
) -> Result:
    """Train, score and save an agent.

    SIGINT and SIGTERM end the training early; the model is saved all the same, and `resume` goes on from the last
    checkpoint.

    Args:
        config: What to learn, and how.
        options: How to run it.
        record: Further arguments of the command, for the run's `args.yml`.
        on_score: Called with the run directory after every score but the last.

    Raises:
        ConfigError: If the environment or the model refuses its arguments, the disk is full, or a process that steps
            an environment died.
    """
    run = create_run(options.log_folder, config.algo, config.env_id)
    tensorboard = _tensorboard_folder(options, config)
    args = {**(record or {}), "algo": config.algo, "env": config.env_id, **asdict(options), "tensorboard": tensorboard}
    save_records(run, config, args)
    with locked(run):
        try:
            return _train_in(run, config, options, tensorboard, on_score=on_score)
        except Refused:
            shutil.rmtree(run)  # it has nothing in it yet
            raise


def resume(run: Path, verbose: int = 1, on_score: OnScore | None = None) -> Result:
    """Go on with a training that was killed or interrupted, with its own settings, from its last checkpoint.

    With the same seed, on a CPU with one thread, it ends as it would have without the interruption, bit for bit.

    Args:
        run: The run directory.
        verbose: As in `Options`.
        on_score: As in `train`.

    Raises:
        ConfigError: If there is no such run, it has ended, or another process trains it.
    """
    config, args = load_record(run)
    names = {field.name for field in fields(Options)}
    options = replace(Options(**{name: args[name] for name in names & args.keys()}), verbose=verbose)
    with locked(run):
        if has_ended(run, config):  # not before: another process may just have brought it to its end
            raise ConfigError(f"'{run}' has ended after {config.n_timesteps} steps; there is nothing to go on with")
        state = newest(run)
        cut_back(_logs(run, args.get("tensorboard")), state["logs"] if state else {})
        for leftover in run.glob("*.partial*"):
            leftover.unlink()
        return _train_in(run, config, options, args.get("tensorboard"), state, on_score)


def _train_in(
    run: Path,
    config: Config,
    options: Options,
    tensorboard: str | None,
    state: State | None = None,
    on_score: OnScore | None = None,
) -> Result:
    """Train in a run directory, from a checkpoint's state if there is one."""
    with _refusals_are_errors():
        env = make_training_env(config, options.seed, str(run), options.vec_env, append=state is not None)
    with _losses_are_errors(env, run):
        with _refusals_are_errors():
            model = make_model(config, env, options.seed, options.device, verbose=max(0, options.verbose - 1))
        if options.trained_agent and state is None:
            with _refusals_are_errors():
                load_weights(model, Path(options.trained_agent), options.trust)
        model.set_logger(_logger(run, tensorboard, options.verbose))
        scoring = make_scoring(config, options, run, on_score)
        callbacks = [*make_callbacks(config), *_own_callbacks(options), scoring]
        callbacks += [TensorboardPictures(scoring, options.seed)] if tensorboard else []
        checkpoint = Checkpoint(run, options.save_freq, callbacks, lambda: _logs(run, tensorboard), state)
        with signals_interrupt(), deaths_are_errors(env):
            interrupted = _learn(model, config, [*callbacks, checkpoint])
        with signals_ignored():
            save_model(model, run / f"{env_name(config.env_id)}.zip")
            if not interrupted:
                remove_checkpoints(run)
    return Result(run, model.num_timesteps, scoring.last, interrupted)


@contextmanager
def _losses_are_errors(env: VecEnv, run: Path) -> Iterator[None]:
    """Close the environments at the end; tell of a dead process or a full disk how to go on."""
    try:
        yield
    except WorkerDied as error:
        raise ConfigError(f"{error.what}; see that there is memory for it, then {how_to_resume(run)}") from error
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        way_out = f"make room, then {how_to_resume(run)}"
        raise ConfigError(f"cannot write to '{run}' ({error.strerror}); {way_out}") from error
    finally:
        close(env)


def _tensorboard_folder(options: Options, config: Config) -> str | None:
    """Make and return the folder of a new run, numbered as SB3 does."""
    if not options.tensorboard_log:
        return None
    parent = Path(options.tensorboard_log) / env_name(config.env_id)
    return str(make_numbered(parent, config.algo.upper()).absolute())


def _logger(run: Path, tensorboard: str | None, verbose: int) -> Logger:
    """SB3's logger; its own silent one would leave a folder in /tmp, and its own numbers a new folder per resume."""
    formats = [*(["stdout"] if verbose > 1 else []), *(["tensorboard"] if tensorboard else [])]
    return configure_logger(tensorboard or str(run), formats) if formats else Logger(str(run), [])


def _logs(run: Path, tensorboard: str | None) -> list[Path]:
    """The files that grow with the training."""
    events = Path(tensorboard).glob("events.*") if tensorboard else ()
    return [*run.glob("*monitor.csv"), *run.glob(EVALUATIONS), *events]


def make_scoring(config: Config, options: Options, run: Path, on_score: OnScore | None = None) -> PoseEvalCallback:
    """Make the callback that scores the agent on the environment's fixed starts."""
    return PoseEvalCallback(
        make_env(config.env_id, config.env_kwargs, config.env_wrapper),
        test_starts(config.env_id, config.env_kwargs),
        run,
        checkpoints(config.algo, config.n_timesteps, options.eval_freq),
        options.n_eval_envs,
        "subproc" if options.n_eval_envs > 1 else "dummy",
        options.verbose,
        on_score,
    )


def _own_callbacks(options: Options) -> list[BaseCallback]:
    return [Progress(options.progress)] if options.verbose else []


def _learn(model: "BaseAlgorithm", config: Config, callbacks: list[BaseCallback]) -> str | None:
    """Learn, and return the name of the signal that ended it, if one did."""
    try:
        model.learn(config.n_timesteps, callback=callbacks)
    except KeyboardInterrupt as interrupt:
        return str(interrupt) or signal.SIGINT.name
    except ValueError as error:
        if model.num_timesteps > 0:
            raise
        raise Refused(str(error)) from error  # a callback that does not go with this model
    finally:
        for callback in callbacks:
            if isinstance(callback, Progress):
                callback.close()
    return None


@contextmanager
def _refusals_are_errors() -> Iterator[None]:
    """Turn the ValueErrors of constructors, which say what is allowed, into the user's error."""
    try:
        yield
    except (ValueError, ConfigError) as error:
        raise Refused(str(error)) from error
