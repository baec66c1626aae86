"""What our algorithms add to any off-policy algorithm: a stereo replay buffer, pre-training, falling exploration."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from sb3_stereo.console import phase
from sb3_stereo.learning.exploration import Annealing, anneal
from sb3_stereo.learning.relabelling import RelabellingReplayBuffer
from sb3_stereo.learning.replay import OWN_SETTINGS, StereoReplayBuffer
from sb3_stereo.task_interface import agreed_n_views, task_of

if TYPE_CHECKING:
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm as Base
else:
    Base = object


UPDATES_A_PART = 100  # a multiple of how many batches are drawn at once, so that the draws are those of one call


class OffPolicyMixin(Base):
    """Comes before an off-policy algorithm among the bases; without its own arguments it changes nothing.

    Args:
        args: Of the algorithm.
        pretraining: Updates per initial random transition, once, before the first action that is not random: "agent"
            is the number of gradient steps.
        exploration: Arguments of `Annealing`: epsilon scales Ornstein-Uhlenbeck noise, or is DQN's exploration rate.
            None leaves both as they are.
        kwargs: Of the algorithm. Where `replay_buffer_kwargs` has settings of `StereoReplayBuffer`, that is the class,
            and the environment is asked for what it must know.

    Raises:
        ValueError: If a setting is unknown, impossible or contradicts another.
    """

    PRETRAINING: tuple[str, ...] = ("agent",)

    def __init__(
        self,
        *args: Any,
        pretraining: Mapping[str, float] | None = None,
        exploration: Mapping[str, float] | None = None,
        **kwargs: Any,
    ) -> None:
        self.pretraining = self._checked_pretraining(pretraining or {})
        self.exploration = None if exploration is None else dict(exploration)
        if exploration is not None:
            Annealing.of(exploration)
        super().__init__(*args, **kwargs)

    def _checked_pretraining(self, pretraining: Mapping[str, float]) -> dict[str, float]:
        for name, ratio in pretraining.items():
            if name not in self.PRETRAINING:
                raise ValueError(f"unknown pretraining {name!r}; choices are {', '.join(self.PRETRAINING)}")
            if isinstance(ratio, bool) or not isinstance(ratio, int | float) or not 0 <= ratio < float("inf"):
                raise ValueError(f"pretraining: {name} must be a number that is not negative, got {ratio!r}")
        return {name: float(pretraining.get(name, 0.0)) for name in self.PRETRAINING}

    def _setup_model(self) -> None:
        self._choose_replay_buffer()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="`n_steps=.* is ignored")  # ours has it from its kwargs
            super()._setup_model()
        if isinstance(self.replay_buffer, RelabellingReplayBuffer) != getattr(self.policy, "relabelling", False):
            raise ValueError(
                "targets are relabelled by StereoDDPG and StereoTD3 with encoder_loss 'dynamics' and relabel_fraction "
                "in replay_buffer_kwargs; set all of it, or leave relabel_fraction and relabelling out"
            )

    @property
    def _relabels(self) -> bool:
        return "relabel_fraction" in self.replay_buffer_kwargs or (
            self.replay_buffer_class is not None and issubclass(self.replay_buffer_class, RelabellingReplayBuffer)
        )

    def _needs_stereo_replay(self) -> bool:
        return not OWN_SETTINGS.isdisjoint(self.replay_buffer_kwargs)

    def _choose_replay_buffer(self) -> None:
        if self.replay_buffer_class is None and self._needs_stereo_replay():
            self.replay_buffer_class = RelabellingReplayBuffer if self._relabels else StereoReplayBuffer
        buffer_class = self.replay_buffer_class
        if buffer_class is None:
            return
        given = {"n_steps": self.n_steps, "gamma": self.gamma} if self.n_steps > 1 else {}
        if issubclass(buffer_class, StereoReplayBuffer):
            agreed_n_views(self.env, self.replay_buffer_kwargs, "replay_buffer_kwargs")
            self.replay_buffer_kwargs = {**vars(task_of(self.env)), **given, **self.replay_buffer_kwargs}
        elif given and "n_steps" not in self.replay_buffer_kwargs:
            raise ValueError(
                f"n_steps is {self.n_steps}, and {buffer_class.__name__} samples single transitions; "
                "leave replay_buffer_class out, or set n_steps to 1"
            )

    def _setup_learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> Any:
        prepared = super()._setup_learn(total_timesteps, *args, **kwargs)
        if self.exploration is not None:
            anneal(self, Annealing.of(self.exploration))
        return prepared

    def _on_step(self) -> None:
        """SB3 calls it after every stored transition."""
        super()._on_step()
        # One step before the first action that is not random, so that a score at `learning_starts` sees its effect.
        if self._n_updates == 0 and self.num_timesteps + self.n_envs >= self.learning_starts:
            self._pretrain()
        if self.exploration is not None:
            self.logger.record("rollout/epsilon", Annealing.of(self.exploration).epsilon(self.num_timesteps))

    def _pretrain(self) -> None:
        if n_updates := self._n_pretraining("agent"):
            self._in_parts("pre-training of the agent", n_updates, self._train_agent)

    def _in_parts(self, name: str, n_updates: int, train: Callable[[int, int], None]) -> None:
        """Make many updates, and show how far they are."""
        with phase(name, n_updates, "update") as update:
            for start in range(0, n_updates, UPDATES_A_PART):
                n = min(UPDATES_A_PART, n_updates - start)
                train(n, self.batch_size)
                update(start + n)

    def _n_pretraining(self, what: str) -> int:
        return round(self.pretraining[what] * self.learning_starts)

    def _train_agent(self, gradient_steps: int, batch_size: int) -> None:
        self.train(gradient_steps=gradient_steps, batch_size=batch_size)
