"""Learning before acting: gradient steps on the first random transitions cost no interaction."""

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm


def can_learn(model: OffPolicyAlgorithm) -> bool:
    """Whether `learning_starts` is over and a transition is there; SB3 stores the first one after the callbacks."""
    assert model.replay_buffer is not None
    return model.num_timesteps >= model.learning_starts and model.replay_buffer.size() > 0


class WarmUp(BaseCallback):
    """Train on the random transitions once, when `learning_starts` of them are there.

    Args:
        replay_ratio: Updates per random transition.
        verbose: As in SB3.
    """

    def __init__(self, replay_ratio: float, verbose: int = 0) -> None:
        super().__init__(verbose)
        self.replay_ratio = replay_ratio

    def _on_training_start(self) -> None:
        if not isinstance(self.model, OffPolicyAlgorithm):
            raise ValueError(
                f"WarmUp repeats stored transitions, and {type(self.model).__name__} stores none; leave it out"
            )

    def _on_step(self) -> bool:
        model = self.model
        assert isinstance(model, OffPolicyAlgorithm)
        n_updates = round(self.replay_ratio * model.learning_starts)
        if n_updates > 0 and model._n_updates == 0 and can_learn(model):
            model.train(gradient_steps=n_updates, batch_size=model.batch_size)
        return True
