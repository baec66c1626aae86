"""The paper's protocol (section 5.2): start from 100 fixed poses, count successes and steps."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from sb3_stereo.building.factory import make_env
from sb3_stereo.building.workers import close, deaths_are_errors
from sb3_stereo.config.components import Component
from sb3_stereo.envs import ENV_IDS, GOAL_ENV_IDS, TWIN_OF
from sb3_stereo.errors import ConfigError

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

N_TEST_POSES = 100  # the paper, section 5.2
NEAR = 0.05  # [m], what panda-gym and Gymnasium-Robotics' FetchReach count as reached
InitialState = Mapping[str, Any]  # keyword arguments of one `env.reset`


@dataclass(frozen=True)
class Evaluation:
    """Scores of one agent over a set of initial states.

    Attributes:
        success_rate: Share of the starts from which the goal was reached, 0 to 1.
        mean_steps_success: Steps per reached goal; NaN if there was none.
        mean_steps_capped: Steps per start, a failure counted as the episode's cap.
        mean_pixel_distance: Final distance of the markers, mean over cameras and episodes [px]; NaN if never seen.
        mean_return: Undiscounted sum of rewards per start.
        n_poses: Number of initial states.
        mean_action: Mean |action| over all visited states, 1 if saturated; NaN for discrete actions.
        mean_q: Mean value that the critic gives to the actions taken.
        median_distance_success: Distance in space of end effector and target at reached goals, the median [m]; NaN if
            there was none, or the environment does not tell it.
        p95_distance_success: Likewise, the 95th percentile [m].
        within_5cm: Share of the starts from which the goal was reached with at most 5 cm left in space, 0 to 1; NaN
            if the environment does not tell.
        success: Per start, whether the goal was reached.  # (n_poses,)
        steps: Per start, the episode's length.  # (n_poses,)
        pixel_distance: Per start, the final distance [px], NaN where undefined.  # (n_poses,)
        returns: Per start, the sum of rewards.  # (n_poses,)
        distance: Per start, the final distance in space [m], NaN where it is not told.  # (n_poses,)
    """

    success_rate: float
    mean_steps_success: float
    mean_steps_capped: float
    mean_pixel_distance: float
    mean_return: float
    n_poses: int
    mean_action: float
    mean_q: float
    median_distance_success: float
    p95_distance_success: float
    within_5cm: float
    success: np.ndarray
    steps: np.ndarray
    pixel_distance: np.ndarray
    returns: np.ndarray
    distance: np.ndarray

    def scores(self) -> dict[str, float]:
        """Return the numbers without the arrays."""
        return {key: value for key, value in vars(self).items() if not isinstance(value, np.ndarray)}


def summarise(
    success: np.ndarray,
    steps: np.ndarray,
    pixel_distance: np.ndarray,
    returns: np.ndarray,
    max_steps: int,
    mean_action: float = np.nan,
    mean_q: float = np.nan,
    distance: np.ndarray | None = None,
) -> Evaluation:
    """Turn per-start records into scores.

    Args:
        success: Whether the goal was reached.  # (n_poses,)
        steps: Lengths of the episodes.  # (n_poses,)
        pixel_distance: Final distances [px], NaN where undefined.  # (n_poses,)
        returns: Sums of rewards.  # (n_poses,)
        max_steps: What a failure counts in `mean_steps_capped`.
        mean_action: Passed on.
        mean_q: Passed on.
        distance: Final distances in space [m], NaN where the environment does not tell.  # (n_poses,)
    """
    success = np.asarray(success, dtype=bool)
    distance = np.full(len(success), np.nan) if distance is None else np.asarray(distance, dtype=float)
    reached = distance[success & ~np.isnan(distance)]
    told = not np.isnan(distance).all()
    return Evaluation(
        success_rate=float(success.mean()),
        mean_steps_success=nan_mean(np.where(success, steps, np.nan)),
        mean_steps_capped=float(np.where(success, steps, max_steps).mean()),
        mean_pixel_distance=nan_mean(pixel_distance),
        mean_return=float(np.mean(returns)),
        n_poses=len(success),
        mean_action=mean_action,
        mean_q=mean_q,
        median_distance_success=float(np.median(reached)) if reached.size else float("nan"),
        p95_distance_success=float(np.quantile(reached, 0.95)) if reached.size else float("nan"),
        within_5cm=float(np.sum(reached <= NEAR) / len(success)) if told else float("nan"),
        success=success,
        steps=np.asarray(steps),
        pixel_distance=np.asarray(pixel_distance),
        returns=np.asarray(returns),
        distance=distance,
    )


def nan_mean(values: Sequence[float] | np.ndarray) -> float:
    """Return the mean of what is not NaN, or NaN without a warning if there is nothing else."""
    defined = np.asarray(values, dtype=float)
    defined = defined[~np.isnan(defined)]
    return float(defined.mean()) if defined.size else float("nan")


def eval_poses(env_id: str) -> np.ndarray:
    """Return the fixed test poses of an environment, in the order of the action, in [rad].  # (100, n_joints)

    Raises:
        ConfigError: If the environment has none.
    """
    return _test_table(env_id)[0]


eval_poses.__test__ = False  # type: ignore[attr-defined] # pytest would take it for a test


def _test_table(env_id: str) -> tuple[np.ndarray, np.ndarray | None]:
    """The poses, and the targets (100, 3) in [m] if the environment's are drawn."""
    file = resources.files("sb3_stereo.envs") / "assets" / "test_poses" / f"{TWIN_OF.get(env_id, env_id)}.csv"
    if not file.is_file():
        raise ConfigError(f"no test poses for '{env_id}'; use random ones with --poses N --seed S")
    rows = csv.reader(io.StringIO(file.read_text(encoding="utf-8")))
    n_joints = sum(not name.startswith("target_") for name in next(rows))
    values = np.array([[float(value) for value in row] for row in rows])
    return values[:, :n_joints], values[:, n_joints:] if values.shape[1] > n_joints else None


def pose_initial_states(poses: np.ndarray, targets: np.ndarray | None = None) -> list[InitialState]:
    """Return resets into joint positions [rad], with targets [m] if given; the seed fixes whatever else is drawn."""
    initial_states: list[InitialState] = [
        {"seed": i, "options": {"joint_positions": pose}} for i, pose in enumerate(poses)
    ]
    for start, target in zip(initial_states, [] if targets is None else targets):
        start["options"]["target_position"] = target
    return initial_states


def random_initial_states(n: int, seed: int) -> list[InitialState]:
    """Return resets into poses that the environment draws itself, the same for the same seed."""
    return [{"seed": int(s)} for s in np.random.default_rng(seed).integers(2**31, size=n)]


def eval_initial_states(env_id: str, env_kwargs: Mapping[str, Any] | None = None) -> list[InitialState]:
    """Return the fixed initial states of an evaluation: our test poses; for other arms or tasks, 100 seeded resets.

    A goal environment with a fixed target is the task of version 1, and so are its poses.
    """
    kwargs = env_kwargs or {}
    if env_id in GOAL_ENV_IDS and kwargs.get("random_target") is False:
        env_id = env_id.replace("Goal-v0", "-v1")
    if env_id in (*ENV_IDS, *TWIN_OF) and not {"arm", "n_joints"} & set(kwargs):
        return pose_initial_states(*_test_table(env_id))
    return random_initial_states(N_TEST_POSES, seed=0)


eval_initial_states.__test__ = False  # type: ignore[attr-defined]


class StartSequence(gym.Wrapper):
    """Let successive resets begin at given initial states, whatever their own arguments; the last start repeats."""

    def __init__(self, env: gym.Env, initial_states: Sequence[InitialState]) -> None:
        super().__init__(env)
        self.initial_states = list(initial_states)
        self.n_resets = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset into the next start."""
        start = self.initial_states[min(self.n_resets, len(self.initial_states) - 1)]
        self.n_resets += 1
        return self.env.reset(**start)


def evaluate_poses(
    model: "BaseAlgorithm",
    env_id: str,
    poses: np.ndarray,
    env_kwargs: Mapping[str, Any] | None = None,
    wrappers: Sequence[Component] = (),
    n_envs: int = 1,
    vec_env_cls: type[DummyVecEnv] | type[SubprocVecEnv] = DummyVecEnv,
) -> Evaluation:
    """Score an agent from given joint positions [rad].  # poses (n, 4)"""
    return evaluate(
        model, make_env(env_id, env_kwargs or {}, wrappers), pose_initial_states(poses), n_envs, vec_env_cls
    )


def evaluate(
    model: "BaseAlgorithm",
    env_fn: Callable[[], gym.Env],
    initial_states: Sequence[InitialState],
    n_envs: int = 1,
    vec_env_cls: type[DummyVecEnv] | type[SubprocVecEnv] = DummyVecEnv,
    progress: Callable[[int], object] = lambda n_done: None,
) -> Evaluation:
    """Score an agent's deterministic actions, one episode from each start.

    The scores do not depend on `n_envs`: every start has its own seed, and every state is judged by itself.

    Args:
        model: The agent.
        env_fn: Makes the environment with all its wrappers.
        initial_states: Resets to begin from, at least one.
        n_envs: Environments that are stepped together, each with its share of the initial states.
        vec_env_cls: How they are stepped.
        progress: Called with the number of finished initial states.

    Raises:
        ConfigError: If there is no start, or a process that steps an environment died.
    """
    if not initial_states:
        raise ConfigError("there is nothing to evaluate: give at least one pose")
    shares = [initial_states[i::n_envs] for i in range(min(n_envs, len(initial_states)))]
    env = vec_env_cls([_starting(env_fn, share) for share in shares])
    try:
        with deaths_are_errors(env):
            return _Scoring(model, env, [len(share) for share in shares]).run(progress)
    finally:
        close(env)


def _starting(env_fn: Callable[[], gym.Env], share: Sequence[InitialState]) -> Callable[[], gym.Env]:
    return lambda: StartSequence(env_fn(), share)


class _Scoring:
    """Plays every environment's share of the initial states and keeps the records in their order."""

    def __init__(self, model: "BaseAlgorithm", env: VecEnv, counts: Sequence[int]) -> None:
        self.model = model
        self.env = env
        self.counts = counts
        self.finished = [0] * len(counts)
        self.current = [(0, 0.0)] * len(counts)  # steps and return of the running episodes
        self.records: dict[int, tuple[bool, int, float, float, float]] = {}
        self.actions: list[float] = []
        self.q_values: list[float] = []

    def run(self, progress: Callable[[int], object]) -> Evaluation:
        observations: Any = self.env.reset()
        while any(done < count for done, count in zip(self.finished, self.counts, strict=True)):
            actions = np.array([self._act(i, _one(observations, i)) for i in range(self.env.num_envs)])
            observations, rewards, dones, infos = self.env.step(actions)
            for i in range(self.env.num_envs):
                self._record(i, float(rewards[i]), bool(dones[i]), infos[i])
            progress(len(self.records))
        columns = zip(*(self.records[i] for i in sorted(self.records)), strict=True)
        success, steps, pixels, returns, distance = (np.array(column) for column in columns)
        cap = self.env.get_attr("spec")[0].max_episode_steps or int(steps.max())
        mean_action, mean_q = nan_mean(self.actions), nan_mean(self.q_values)
        return summarise(success, steps, pixels, returns, cap, mean_action, mean_q, distance)

    def _act(self, i: int, observation: Any) -> Any:
        """Act on one state alone: a batch of another size would round differently."""
        action = self.model.predict(observation, deterministic=True)[0]
        if self.finished[i] < self.counts[i]:
            self.q_values.append(q_value(self.model, observation, action))
            self.actions.append(float(np.abs(action).mean()) if action.dtype.kind == "f" else float("nan"))
        return action

    def _record(self, i: int, reward: float, done: bool, info: dict[str, Any]) -> None:
        if self.finished[i] == self.counts[i]:
            return
        steps, total = self.current[i]
        self.current[i] = (steps + 1, total + reward)
        if not done:
            return
        pixels = nan_mean(info.get("pixel_distances", ()))
        success, distance = bool(info.get("is_success", False)), float(info.get("distance", np.nan))
        index = i + len(self.counts) * self.finished[i]  # the shares are every n-th start
        self.records[index] = (success, steps + 1, pixels, total + reward, distance)
        self.finished[i] += 1
        self.current[i] = (0, 0.0)


def _one(observations: Any, i: int) -> Any:
    """The observation of one environment, also of a map of names to arrays."""
    return {key: part[i] for key, part in observations.items()} if isinstance(observations, dict) else observations[i]


def q_value(model: "BaseAlgorithm", observation: Any, action: Any) -> float:
    """Return the critic's value of one action, the smallest of several critics; NaN for an agent without.

    A critic of quantiles (TQC) gives their mean. PPO's values states and not actions, so it counts as none.
    """
    import torch as th

    policy: Any = getattr(model, "policy", None)
    if policy is None:  # what only predicts, such as `SwitchedAgent`
        return float("nan")
    policy.set_training_mode(False)
    with th.no_grad():
        tensor, _ = policy.obs_to_tensor(observation)
        if hasattr(policy, "q_net"):
            return float(policy.q_net(tensor)[0, int(action)])
        if not hasattr(policy, "critic"):
            return float("nan")
        scaled = th.as_tensor(policy.scale_action(action[None]), dtype=th.float32, device=policy.device)
        values = policy.critic(tensor, scaled)
        if isinstance(values, th.Tensor):
            return float(values.mean(dim=2).min())  # (batch, n_critics, n_quantiles)
        return float(min(q[0, 0] for q in values))
