"""Evaluate the agent on the test poses during training."""

import csv
import io
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from sb3_stereo.building.factory import VEC_ENVS
from sb3_stereo.console import phase, print_line
from sb3_stereo.evaluation.protocol import Evaluation, InitialState, evaluate
from sb3_stereo.runs.directory import BEST_MODEL, EVALUATIONS
from sb3_stereo.runs.files import write
from sb3_stereo.runs.models import save_model

OnEvaluation = Callable[[Path], None]

# Training steps of the paper's Tables 3 and 4.
PAPER_EVAL_STEPS = {
    "ddpg": (1500, 2000, 5000, 7000, 8500),
    "dqn": (1500, 3500, 5500, 7500, 10000),
}


def eval_steps(algo: str, n_timesteps: int, eval_freq: int = 0) -> tuple[int, ...]:
    """Return the steps at which an agent is scored before the end of its training.

    Args:
        algo: The algorithm, which decides the paper's steps; one that the paper has not takes DDPG's.
        n_timesteps: Steps of the training; the score at its end is not part of the list.
        eval_freq: 0 takes the paper's steps, a positive number every so many steps, a negative one none.
    """
    if eval_freq > 0:
        return tuple(range(eval_freq, n_timesteps, eval_freq))
    steps = PAPER_EVAL_STEPS.get(algo, PAPER_EVAL_STEPS["ddpg"])
    return tuple(step for step in steps if step < n_timesteps) if eval_freq == 0 else ()


class PoseEvalCallback(BaseCallback):
    """Scores the agent at given steps and at the end, and keeps the records and the best model.

    Args:
        env_fn: Makes the environment with all its wrappers.
        initial_states: Resets to begin from.
        run_dir: Where `evaluations.csv` and `best_model.zip` go.
        steps: Environment steps at which to score; the end of the training is always scored.
        n_envs: Environments that are stepped together.
        vec_env: "dummy" or "subproc".
        verbose: 1 prints a line per score.
        on_evaluation: Called with the run directory after every score but the one at the end of the training.
    """

    def __init__(
        self,
        env_fn: Any,
        initial_states: Sequence[InitialState],
        run_dir: Path,
        steps: Sequence[int] = (),
        n_envs: int = 1,
        vec_env: str = "dummy",
        verbose: int = 0,
        on_evaluation: OnEvaluation | None = None,
    ) -> None:
        super().__init__(verbose)
        self.env_fn = env_fn
        self.initial_states = initial_states
        self.run_dir = run_dir
        self.steps = sorted(steps)
        self.n_envs = n_envs
        self.vec_env = vec_env
        self.on_evaluation = on_evaluation
        self.best: tuple[float, float] | None = None
        self.last: Evaluation | None = None

    def _on_training_start(self) -> None:
        self.start_time = time.monotonic()

    def _on_step(self) -> bool:
        due = [step for step in self.steps if step <= self.num_timesteps]
        self.steps = self.steps[len(due) :]
        if due and self.num_timesteps < self.locals.get("total_timesteps", float("inf")):
            self.score()
            if self.on_evaluation is not None:
                self.on_evaluation(self.run_dir)
        return True

    def _on_training_end(self) -> None:
        self.num_timesteps = self.model.num_timesteps
        self.score()

    def score(self) -> Evaluation:
        """Score the agent now."""
        with phase("evaluation", len(self.initial_states), "pose") as update:
            result = evaluate(self.model, self.env_fn, self.initial_states, self.n_envs, VEC_ENVS[self.vec_env], update)
        self.last = result
        scores = result.scores()
        append_row(self.run_dir / EVALUATIONS, {"timesteps": self.num_timesteps} | scores | self._elapsed())
        for name, value in scores.items():
            self.logger.record(f"eval/{name}", value)
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)
        self._keep_best(result)
        if self.verbose:
            print_line(f"{self.num_timesteps} steps: {describe(result)}")
        return result

    def state_dict(self) -> dict[str, Any]:
        """Return what the coming scores depend on."""
        return {"best": self.best, **self._elapsed()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a `state_dict`."""
        self.best = state["best"]
        self.start_time -= state["seconds"]
        self.steps = [step for step in self.steps if step > self.num_timesteps]

    def _elapsed(self) -> dict[str, float]:
        return {"seconds": round(time.monotonic() - self.start_time, 1)}

    def _keep_best(self, result: Evaluation) -> None:
        """Keep the model with the most successes, then with the fewest steps."""
        quality = (result.success_rate, -result.mean_steps_capped)
        if self.best is not None and quality <= self.best:
            return
        self.best = quality
        save_model(self.model, self.run_dir / BEST_MODEL)


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Append one row to a CSV file, with a header if there is none; the file is never half written.

    A file that another version has begun keeps its columns.
    """
    before = path.read_bytes().decode() if path.is_file() else ""
    columns = before.splitlines()[0].split(",") if before else list(row)
    text = io.StringIO(before, newline="")
    text.seek(0, io.SEEK_END)
    writer = csv.DictWriter(text, fieldnames=columns, restval="nan", extrasaction="ignore")
    if not before:
        writer.writeheader()
    writer.writerow(row)
    write(path, text.getvalue().encode())


def describe(result: Evaluation) -> str:
    """Return a score as a phrase a person can read."""
    reached = int(result.success.sum())
    steps = f", {result.mean_steps_success:.2f} steps on average" if reached else ""
    near = result.median_distance_success
    space = "" if math.isnan(near) else f", a median of {100 * near:.1f} cm from it"
    return (
        f"reached the target from {reached} of {result.n_poses} poses ({100 * result.success_rate:.0f} %){space}"
        f"{steps}, {result.mean_steps_capped:.2f} with failures counted as the cap"
    )
