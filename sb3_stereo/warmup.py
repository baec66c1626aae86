"""Learning before acting: gradient steps on the first random transitions cost no interaction."""

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm


class WarmUp(BaseCallback):
    """Train on the random transitions once, when `learning_starts` of them are there.

    Args:
        replay_ratio: Updates per random transition.
        verbose: As in SB3.
    """

    def __init__(self, replay_ratio: float, verbose: int = 0) -> None:
        super().__init__(verbose)
        self.replay_ratio = replay_ratio

    def _on_step(self) -> bool:
        model = self.model
        assert isinstance(model, OffPolicyAlgorithm)
        if model._n_updates == 0 and self.num_timesteps >= model.learning_starts:
            model.train(gradient_steps=round(self.replay_ratio * model.learning_starts), batch_size=model.batch_size)
        return True
