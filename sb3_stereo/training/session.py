"""One process's part of a training run: set up, learn, save."""

from pathlib import Path
from typing import TYPE_CHECKING

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.logger import configure as configure_logger
from stable_baselines3.common.vec_env import VecEnv

from sb3_stereo.building.factory import (
    check_evaluated_spaces,
    make_callbacks,
    make_env,
    make_model,
    make_training_env,
)
from sb3_stereo.building.workers import close, deaths_are_errors
from sb3_stereo.config.schema import Config
from sb3_stereo.errors import setting_up
from sb3_stereo.evaluation.callback import OnEvaluation, PoseEvalCallback, eval_steps
from sb3_stereo.evaluation.protocol import eval_initial_states
from sb3_stereo.evaluation.tensorboard import TensorboardPictures
from sb3_stereo.runs import snapshots, status
from sb3_stereo.runs.directory import env_name
from sb3_stereo.runs.models import load_weights, save_model
from sb3_stereo.runs.tensorboard import event_sizes
from sb3_stereo.runs.training_state import State, check_can_be_captured
from sb3_stereo.training.errors import Refused
from sb3_stereo.training.options import Options, Result
from sb3_stereo.training.progress import Progress
from sb3_stereo.training.signals import Interruptions, StopOnSignal
from sb3_stereo.training.tracking import make_tracker

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm


class Session:
    """Trains in a run directory, from a snapshot's state if there is one.

    Args:
        run: The run directory; this process holds it.
        config: What to learn.
        options: How to run it.
        tensorboard: The folder for TensorBoard; None writes nothing.
        state: To begin from.
        on_evaluation: As in `train`.
    """

    def __init__(
        self,
        run: Path,
        config: Config,
        options: Options,
        tensorboard: Path | None = None,
        state: State | None = None,
        on_evaluation: OnEvaluation | None = None,
    ) -> None:
        self.run, self.config, self.options, self.tensorboard = run, config, options, tensorboard
        self.first_step = 0 if state is None else int(state["step"])
        self._state = state
        self._on_evaluation = on_evaluation
        self._env: VecEnv | None = None
        self._model: BaseAlgorithm | None = None
        self._tracker: KVWriter | None = None
        self._evaluation: PoseEvalCallback | None = None

    def train(self, interruptions: Interruptions) -> Result:
        """Learn until the end or the first signal, and save.

        Raises:
            Refused: If the training cannot begin.
        """
        try:
            ended = interruptions.run(lambda: self._learn(interruptions))
            model = self._save(ended)
        finally:
            if self._tracker is not None:
                self._tracker.close()
            if self._env is not None:
                close(self._env)
        steps = max(self.first_step, self._model.num_timesteps if self._model else 0)
        last = self._evaluation.last if self._evaluation else None
        return Result(self.run, steps, last, None if ended else interruptions.name, model)

    def _learn(self, interruptions: Interruptions) -> None:
        config, options, state = self.config, self.options, self._state
        self._state = None  # it is as large as the replay buffer
        with setting_up(config.env_id, Refused):
            self._env = make_training_env(config, options.seed, str(self.run), options.vec_env, state is not None)
        with deaths_are_errors(self._env):
            with setting_up(config.algo, Refused):
                check_evaluated_spaces(config, self._env)
                self._model = make_model(
                    config, self._env, options.seed, options.device, verbose=max(0, options.verbose - 1)
                )
                if options.trained_agent and state is None:
                    load_weights(self._model, Path(options.trained_agent), options.trust)
            if options.save_freq > 0:
                check_can_be_captured(self._model)
            logger = _logger(self.run, self.tensorboard, options.verbose)
            with setting_up("the tracker", Refused):
                self._tracker = make_tracker(self.run, config, options)
            logger.output_formats += [self._tracker] if self._tracker is not None else []
            self._model.set_logger(logger)
            with setting_up("the callbacks", Refused):
                callbacks = self._callbacks()
            snapshot = snapshots.SaveSnapshots(
                self.run, options.save_freq, callbacks, lambda: event_sizes(self.tensorboard), state
            )
            del state
            _learn(self._model, config.n_timesteps, [*callbacks, snapshot, StopOnSignal(interruptions)])

    def _callbacks(self) -> list[BaseCallback]:
        """The callbacks that have a state."""
        evaluation = self._evaluation = make_evaluation(
            self.config.evaluated, self.options, self.run, self._on_evaluation
        )
        progress = [Progress(self.options.progress)] if self.options.verbose else []
        pictures = [TensorboardPictures(evaluation, self.options.seed)] if self.tensorboard else []
        # The progress last: in the end it is closed after the last evaluation, which it shows.
        return [*make_callbacks(self.config), evaluation, *pictures, *progress]

    def _save(self, ended: bool) -> Path | None:
        """Save the model; what says that the run has ended comes last."""
        if self._model is None or self._model.num_timesteps == 0:
            return None
        path = self.run / f"{env_name(self.config.env_id)}.zip"
        save_model(self._model, path)
        if ended:
            status.mark(self.run, status.ENDED)
            snapshots.remove(self.run)
        return path


def make_evaluation(
    config: Config, options: Options, run: Path, on_evaluation: OnEvaluation | None = None
) -> PoseEvalCallback:
    """Make the callback that evaluates the agent from the environment's fixed starts."""
    initial_states = eval_initial_states(config.env_id, config.env_kwargs)
    return PoseEvalCallback(
        make_env(config.env_id, config.env_kwargs, config.env_wrapper),
        initial_states[: options.eval_episodes or len(initial_states)],
        run,
        eval_steps(config.algo, config.n_timesteps, options.eval_freq),
        options.n_eval_envs,
        "subproc" if options.n_eval_envs > 1 else "dummy",
        options.verbose,
        on_evaluation,
    )


def _logger(run: Path, tensorboard: Path | None, verbose: int) -> Logger:
    """SB3's logger; its own silent one would leave a folder in /tmp, and its own numbers a new folder per resume."""
    formats = [*(["stdout"] if verbose > 1 else []), *(["tensorboard"] if tensorboard else [])]
    return configure_logger(str(tensorboard or run), formats) if formats else Logger(str(run), [])


def _learn(model: "BaseAlgorithm", n_timesteps: int, callbacks: list[BaseCallback]) -> None:
    try:
        model.learn(n_timesteps, callback=callbacks)
    except Exception:
        if model.num_timesteps > 0:
            raise
        with setting_up("the training run", Refused):  # what does not go together is noticed before the first step
            raise
    finally:
        for callback in callbacks:
            if isinstance(callback, Progress):
                callback.close()
