"""The progress of a training run on the terminal or in a log file."""

from stable_baselines3.common.callbacks import BaseCallback

from sb3_stereo.console import Bar


class Progress(BaseCallback):
    """Shows steps, recent success rate, speed and the time left of a training.

    Args:
        bar: As in `Bar`.
        interval: As in `Bar`.
    """

    def __init__(self, bar: bool | None = None, interval: float = 30.0) -> None:
        super().__init__()
        self.bar, self.interval = bar, interval
        self.shown: Bar | None = None

    def _on_training_start(self) -> None:
        self.total = self.locals["total_timesteps"]

    def _on_rollout_start(self) -> None:
        if self.shown is None:  # not before: a training that goes on has its number of steps only now
            self.shown = Bar(self.total, "step", self.bar, self.interval, self.num_timesteps)

    def _on_step(self) -> bool:
        if self.shown is not None:
            self.shown.update(self.num_timesteps, f"success {self._success()}")
        return True

    def _on_training_end(self) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bar as it stands; may be called twice."""
        if self.shown is not None:
            self.shown.close()

    def _success(self) -> str:
        """Return the share of the last 100 episodes that reached the goal."""
        recent = self.model.ep_success_buffer
        return f"{100 * sum(recent) / len(recent):.0f} %" if recent else "–"
