"""Callbacks that version 0.0 had in place of our algorithms' settings; to be removed with 0.2.

They bring the same into SB3's own algorithms, one by one, and their order counts. `StereoDDPG` and the others that are
ours need none.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3 import DQN
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from sb3_stereo.learning.exploration import AnnealedOrnsteinUhlenbeckNoise, Annealing, anneal
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.policies.dynamics import DynamicsHeads
from sb3_stereo.task_interface import agreed_n_views, check_offsets, task_of

__all__ = [
    "AnnealExploration",
    "AnnealedOrnsteinUhlenbeckNoise",
    "LearnFromMotion",
    "StereoReplay",
    "StereoReplayBuffer",
    "WarmUp",
]


class _Deprecated(BaseCallback):
    INSTEAD = ""

    def __init__(self, verbose: int = 0) -> None:
        super().__init__(verbose)
        warnings.warn(
            f"{type(self).__name__} will go with version 0.2; StereoDDPG and its siblings have {self.INSTEAD} instead",
            FutureWarning,
            stacklevel=3,
        )

    def _on_step(self) -> bool:
        return True


class AnnealExploration(_Deprecated):
    """Let epsilon fall linearly over a number of environment steps, and log it.

    Args:
        n_steps: As in `Annealing`.
        initial_epsilon: As in `Annealing`.
        final_epsilon: As in `Annealing`.
        theta: As in `Annealing`.
        verbose: As in SB3.
    """

    INSTEAD = "exploration"

    def __init__(
        self,
        n_steps: int = 10_000,
        initial_epsilon: float = 1.0,
        final_epsilon: float = 0.1,
        theta: float = 0.15,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.annealing = Annealing.of(
            {"n_steps": n_steps, "initial_epsilon": initial_epsilon, "final_epsilon": final_epsilon, "theta": theta}
        )

    @property
    def epsilon(self) -> float:
        """Epsilon at the model's present step."""
        return self.annealing.epsilon(self.model.num_timesteps)

    def _on_training_start(self) -> None:
        anneal(self.model, self.annealing)

    def _on_step(self) -> bool:
        self.logger.record("rollout/epsilon", self.epsilon)
        return True


class StereoReplay(_Deprecated):
    """Make a model's replay buffer a `StereoReplayBuffer` with the same transitions.

    Args:
        n_views: As in `StereoReplayBuffer`; None asks the environment.
        mirrored_joints: As in `StereoReplayBuffer`; None asks the environment.
        n_joints: As in `StereoReplayBuffer`; None asks `QuantizedActions`.
        mirror_probability: As in `StereoReplayBuffer`.
        goal_share: `success_fraction` of `StereoReplayBuffer`.
        verbose: As in SB3.
    """

    INSTEAD = "replay_buffer_kwargs"

    def __init__(
        self,
        n_views: int | None = None,
        mirrored_joints: Sequence[int] | None = None,
        n_joints: int | None = None,
        mirror_probability: float | None = None,
        goal_share: float = 0.0,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        settings = {"n_views": n_views, "mirrored_joints": mirrored_joints, "n_joints": n_joints}
        self.settings: dict[str, Any] = {name: value for name, value in settings.items() if value is not None}
        self.settings |= {"mirror_probability": mirror_probability, "success_fraction": goal_share}

    def _on_training_start(self) -> None:
        replace_buffer(self.model, **self.settings)


def replace_buffer(model: BaseAlgorithm, **settings: Any) -> None:
    """Give a model a `StereoReplayBuffer` with the transitions of its own buffer.

    Args:
        model: Any off-policy one.
        settings: Of `StereoReplayBuffer`, where the environment or the model is not to be asked.

    Raises:
        ValueError: If the model has no buffer, or another kind of transitions.
    """
    if not isinstance(model, OffPolicyAlgorithm) or model.replay_buffer is None:
        raise ValueError(f"a StereoReplayBuffer replaces a replay buffer, and {type(model).__name__} has none")
    agreed_n_views(model.env, settings, "StereoReplay")
    old = model.replay_buffer
    stereo = StereoReplayBuffer(
        model.buffer_size,
        model.observation_space,
        model.action_space,
        device=model.device,
        n_envs=model.n_envs,
        optimize_memory_usage=model.optimize_memory_usage,
        handle_timeout_termination=old.handle_timeout_termination,
        n_steps=model.n_steps,
        gamma=model.gamma,
        **{**vars(task_of(model.env)), **settings},
    )
    arrays = {name: value for name, value in vars(old).items() if isinstance(value, np.ndarray)}
    vars(stereo).update(arrays, pos=old.pos, full=old.full)
    model.replay_buffer = stereo


def _can_learn(model: OffPolicyAlgorithm) -> bool:
    """Whether `learning_starts` is over and a transition is there; SB3 stores the first one after the callbacks."""
    assert model.replay_buffer is not None
    return model.num_timesteps >= model.learning_starts and model.replay_buffer.size() > 0


class LearnFromMotion(_Deprecated):
    """Train the encoder on `DynamicsHeads` between the environment step and SB3's gradient steps.

    Args:
        gradient_steps: Updates after every environment step.
        replay_ratio: Updates per random transition before the first action.
        learning_rate: Adam's.
        batch_size: Transitions per update.
        verbose: As in SB3.
    """

    INSTEAD = "dynamics_steps and pretraining.dynamics"

    def __init__(
        self,
        gradient_steps: int = 2,
        replay_ratio: float = 3.0,
        learning_rate: float = 1e-3,
        batch_size: int = 100,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.gradient_steps, self.replay_ratio = gradient_steps, replay_ratio
        self.learning_rate, self.batch_size = learning_rate, batch_size

    def _on_training_start(self) -> None:
        model: Any = self.model
        heads: DynamicsHeads | None = getattr(model.policy, "dynamics", None)
        if heads is None and not isinstance(model, DQN):
            raise ValueError(
                "LearnFromMotion needs DQN, or a StereoDDPGPolicy with encoder_loss 'dynamics'; set it, or leave it out"
            )
        check_offsets(model.env, task_of(model.env).n_views, "LearnFromMotion")
        if not isinstance(model.replay_buffer, StereoReplayBuffer):
            replace_buffer(model, mirror_probability=0.0)
        if heads is None:
            encoder, buffer = model.policy.q_net.features_extractor, model.replay_buffer
            heads = DynamicsHeads(encoder.features_dim, buffer.n_joints, buffer.n_views).to(model.device)
            heads.add_optimizer(encoder, self.learning_rate)
            vars(model.policy)["dynamics"] = heads  # unregistered: SB3's DQN does not save it
        for group in heads.optimizer.param_groups:
            group["lr"] = self.learning_rate

    def _on_step(self) -> bool:
        model: Any = self.model
        if _can_learn(model):
            if model.policy.dynamics.n_updates == 0:
                self.train(round(self.replay_ratio * model.learning_starts))
            self.train(self.gradient_steps * model.n_envs)
        return True

    def train(self, gradient_steps: int) -> None:
        """Take gradient steps on the encoder and the heads."""
        policy: Any = self.model.policy
        encoder = policy.q_net.features_extractor if isinstance(self.model, DQN) else policy.encoder
        for _ in range(gradient_steps):
            samples = self.model.replay_buffer.sample_dynamics(self.batch_size)  # type: ignore[attr-defined]
            self.logger.record("train/dynamics_loss", policy.dynamics.update(encoder, samples))


class WarmUp(_Deprecated):
    """Train on the random transitions once, when `learning_starts` of them are there.

    Args:
        replay_ratio: Updates per random transition.
        verbose: As in SB3.
    """

    INSTEAD = "pretraining.agent"

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
        if n_updates > 0 and model._n_updates == 0 and _can_learn(model):
            model.train(gradient_steps=n_updates, batch_size=model.batch_size)
        return True
