"""The task for goal-conditioned learners: Gymnasium-Robotics' `GoalEnv` interface, with goals in pixels."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict
from numpy.typing import ArrayLike, NDArray

from sb3_stereo.envs import rewards
from sb3_stereo.envs.capture import Capture, Floats
from sb3_stereo.envs.composite import IMAGE, Observation
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.specs import require, require_known

REWARD_TYPES = ("sparse", "dense")
UNSEEN = -1.0  # both coordinates of a marker that a view does not show
PREVIOUS = "previous_achieved_goal"  # key of `info`: what Eq. 2 compares with


class StereoReachGoalEnv(StereoReachEnv):
    """`StereoReachEnv` whose observations say where end effector and target are in the pictures.

    So transitions can be relabelled with goals that were reached instead (Andrychowicz et al. 2017, HER): where the end
    effector has been is a target, in pixels. SB3's `HerReplayBuffer` takes it as it is.

    Observation: `Dict` of `observation`, the image of `StereoReachEnv`; `achieved_goal` and `desired_goal`, the
    centres (x, y) in [px] of the end effector's and of the target's marker in each view, shape (2 * n_views,), both
    `UNSEEN` in a view that does not show the marker. Such a goal is never reached.

    Args:
        render_mode: As in `StereoReachEnv`.
        reward_type: "sparse" is 0 at the goal and else -1, as in Gymnasium-Robotics. "dense" is Eq. 3, which needs
            the previous goal in `info`: HerReplayBuffer has it with `copy_info_dict: true`.
        kwargs: As in `StereoReachEnv`, but for composite "dict".

    Raises:
        ValueError: If an argument makes no task.
    """

    def __init__(self, render_mode: str | None = None, *, reward_type: str = "sparse", **kwargs: Any) -> None:
        require_known("reward_type", reward_type, REWARD_TYPES, "reward types")
        composite = kwargs.get("composite")
        require(composite != "dict", "composite is 'dict', and a goal environment has one image; take 'channels'")
        super().__init__(render_mode, **kwargs)
        self.reward_type = reward_type
        sizes = [(camera.spec.width, camera.spec.height) for camera in self.cameras]
        goals = Box(UNSEEN, np.ravel(sizes).astype(np.float64), dtype=np.float64)
        self.observation_space = Dict({IMAGE: self.composite.space, "achieved_goal": goals, "desired_goal": goals})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """As in `StereoReachEnv`."""
        image, info = super().reset(seed=seed, options=options)
        return self._with_goals(image), info

    def capture(self) -> Observation:
        """As in `StereoReachEnv`."""
        return self._with_goals(super().capture())

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """As in `StereoReachEnv`, with the reward of the chosen type."""
        info_before = {PREVIOUS: _goals(self._captured)[0]}
        image, reward, terminated, truncated, info = super().step(action)
        sparse = self.reward_type == "sparse"
        return (
            self._with_goals(image),
            float(terminated) - 1.0 if sparse else reward,
            terminated,
            truncated,
            info | info_before,
        )

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """The reward of a step that ended at `achieved_goal` if `desired_goal` had been its goal.

        Args:
            achieved_goal: Shape (2 * n_views,), or (batch, 2 * n_views), in [px].
            desired_goal: Likewise.
            info: Of the step, or a sequence of such, one per transition; used by the dense reward alone.

        Returns:
            A number, or an array (batch,).

        Raises:
            ValueError: If a dense reward lacks the previous goal.
        """
        achieved, desired = np.asarray(achieved_goal, np.float64), np.asarray(desired_goal, np.float64)
        reached = self._reached(achieved, desired)
        if self.reward_type == "sparse":
            return reached - 1.0
        previous = np.reshape(_previous(info), achieved.shape)
        assert self.offset_reward is not None
        dense, _ = self.offset_reward(_offsets(previous, desired), _offsets(achieved, desired))
        return dense if achieved.ndim > 1 else float(dense)

    def compute_terminated(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """Whether `desired_goal` is reached at `achieved_goal`; arguments and shapes as in `compute_reward`."""
        reached = self._reached(np.asarray(achieved_goal, np.float64), np.asarray(desired_goal, np.float64))
        return reached if reached.ndim else bool(reached)

    def compute_truncated(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """Never: the registration limits the steps."""
        shape = np.shape(achieved_goal)[:-1]
        return np.zeros(shape, bool) if shape else False

    def _reached(self, achieved: Floats, desired: Floats) -> NDArray[np.bool_]:
        distances = self.success_distances(_offsets(achieved, desired))
        return np.asarray(rewards.is_goal(distances, self.rho, self.min_views))

    def _with_goals(self, image: Observation) -> dict[str, Any]:
        achieved, desired = _goals(self._captured)
        return {IMAGE: image, "achieved_goal": achieved, "desired_goal": desired}


def _goals(captured: Capture) -> tuple[Floats, Floats]:
    """Achieved and desired goal, shape (2 * n_views,) each, in [px]."""
    achieved, desired = np.nan_to_num(captured.centres, nan=UNSEEN).swapaxes(0, 1).reshape(2, -1)
    return achieved, desired


def _offsets(achieved: Floats, desired: Floats) -> Floats:
    """From desired to achieved goal, shape (..., n_views, 2), in [px]; nan in a view that lacks one of them."""
    one, other = (goal.reshape(*goal.shape[:-1], -1, 2) for goal in (achieved, desired))
    unseen = (one == UNSEEN).all(axis=-1, keepdims=True) | (other == UNSEEN).all(axis=-1, keepdims=True)
    return np.where(unseen, np.nan, one - other)


def _previous(info: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> Floats:
    infos = [info] if isinstance(info, Mapping) else info
    try:
        return np.array([one[PREVIOUS] for one in infos])
    except KeyError:
        raise ValueError(
            f"the dense reward needs info['{PREVIOUS}']; set copy_info_dict to true in the HerReplayBuffer's "
            "arguments, or take reward_type 'sparse'"
        ) from None
