"""Our DQN: SB3's, whose encoder learns from dynamics as well as from the Q-network's loss."""

from __future__ import annotations

from stable_baselines3 import DQN

from sb3_stereo.learning.dynamics import DynamicsMixin


class StereoDQN(DynamicsMixin, DQN):
    """SB3's DQN; with `StereoDQNPolicy` and `encoder_loss` "critic+dynamics" each training begins with the encoder.

    Args:
        args: As in SB3's `DQN`.
        dynamics_steps: Updates of the encoder at each training, by the auxiliary losses of `DynamicsHeads`.
        pretraining: Updates per initial random transition, once, before the first action that is not random:
            "dynamics" of the encoder, then "agent" of the Q-network.
        exploration: Arguments of `Annealing`: epsilon falls over environment steps, in place of SB3's
            `exploration_fraction` of the training.
        kwargs: As in SB3's `DQN`.
    """

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Update the encoder from dynamics, then the Q-network with its encoder by SB3's loss."""
        self._train_dynamics(self.dynamics_steps, batch_size)
        self._train_agent(gradient_steps, batch_size)

    def _train_agent(self, gradient_steps: int, batch_size: int) -> None:
        super().train(gradient_steps, batch_size)
