"""Depth probe: 3-D positions predicted from a trained agent's features.

    python -m benchmarks.analysis.depth logs/ddpg/WamStereoReachRandom-v0_1

puts the arm at random poses of the run's environment, fits a ridge regression from the features that the agent's heads
see to the positions of the end effector and, where it varies, of the target, and tells the errors on poses that took
no part in the fit. Beside them stand those of the same extractor untrained and of a guess, the mean position. The last
line is the distance in space at the end of each episode from the test poses: the goal is judged in the run's own views,
and with one view twice it is a line in space.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.preprocessing import preprocess_obs

from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.flags import Parser, run_command
from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import eval_initial_states, random_initial_states
from sb3_stereo.policies.shared_encoder import SharedEncoderView
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model, untrained_model

Floats = NDArray[np.float64]

POINTS = {"end effector": "end_effector_position", "target": "target_position"}  # to the keys of `info`
TEST_SHARE = 0.2  # of the poses
ALPHAS = 10.0 ** np.arange(-6, 3)  # ridge penalties per pose; what is left of the fit's poses chooses
BATCH_SIZE = 500


class Error(NamedTuple):
    """Of one point, as one extractor gives it: median and 95 % quantile, in [cm]."""

    point: str
    source: str
    median: float
    quantile_95: float


def collect(env: gym.Env[Any, Any], n_poses: int, seed: int) -> tuple[list[Any], dict[str, Floats]]:
    """Observations at random poses, and by the points' names where they are, (n_poses, 3) in [m]."""
    resets = [env.reset(**start) for start in random_initial_states(n_poses, seed)]
    return [image for image, _ in resets], {
        name: np.array([info[key] for _, info in resets]) for name, key in POINTS.items()
    }


@th.no_grad()
def features_of(policy: Any, observations: Sequence[Any]) -> Floats:
    """What the policy's heads see of observations, (n, features_dim)."""
    policy.set_training_mode(False)
    encoder = extractor(policy)
    parts = []
    for start in range(0, len(observations), BATCH_SIZE):
        tensors, _ = policy.obs_to_tensor(_stacked(observations[start : start + BATCH_SIZE]))
        parts.append(encoder(preprocess_obs(tensors, policy.observation_space)).cpu().numpy())
    return np.concatenate(parts).astype(np.float64)


def _stacked(observations: Sequence[Any]) -> Any:
    """Observations as a batch, maps of images as a map of batches."""
    first = observations[0]
    if isinstance(first, dict):
        return {key: np.stack([observation[key] for observation in observations]) for key in first}
    return np.stack(observations)


def extractor(policy: Any) -> th.nn.Module:
    """The trained features extractor: the actor's, the Q-network's, or PPO's."""
    for owner in ("actor", "q_net"):
        if hasattr(policy, owner):
            policy = getattr(policy, owner)
            break
    encoder: th.nn.Module = policy.features_extractor
    return encoder.encoder if isinstance(encoder, SharedEncoderView) else encoder


def read_positions(features: Floats, positions: Floats) -> Floats:
    """Errors of a ridge regression on the last `TEST_SHARE` of the poses.

    Args:
        features: Shape (n_poses, features_dim).
        positions: Shape (n_poses, 3), in [m].

    Returns:
        Distances from the true positions, shape (n_test,), in [m].
    """
    n_fit = round(len(features) * (1 - TEST_SHARE))
    n_choose = round(n_fit * (1 - TEST_SHARE))  # the penalty is chosen on poses of the fit alone
    scores = [_ridge(features[:n_fit], positions[:n_fit], n_choose, alpha).mean() for alpha in ALPHAS]
    return _ridge(features, positions, n_fit, ALPHAS[int(np.argmin(scores))])


def _ridge(features: Floats, positions: Floats, n_fit: int, alpha: float) -> Floats:
    """Errors on what follows the first `n_fit` poses."""
    centre, scale = features[:n_fit].mean(0), features[:n_fit].std(0) + 1e-9
    inputs = (features - centre) / scale
    mean = positions[:n_fit].mean(0)
    gram = inputs[:n_fit].T @ inputs[:n_fit] + alpha * n_fit * np.eye(inputs.shape[1])
    weights = np.linalg.solve(gram, inputs[:n_fit].T @ (positions[:n_fit] - mean))
    return np.asarray(np.linalg.norm(inputs[n_fit:] @ weights + mean - positions[n_fit:], axis=1))


def final_distances(model: Any, env: gym.Env[Any, Any], initial_states: Sequence[Any]) -> Floats:
    """Distance between end effector and target at the end of the episode from each start, (n_starts,) in [m]."""
    distances = []
    for start in initial_states:
        observation, info = env.reset(**start)
        ended = False
        while not ended:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            ended = terminated or truncated
        distances.append(np.linalg.norm(np.subtract(*(info[key] for key in POINTS.values()))))
    return np.array(distances)


def probe(config: Config, model_file: Path, n_poses: int = 5000, seed: int = 0) -> list[Error]:
    """Measure a run's model.

    Args:
        config: The run's.
        model_file: Its zip file.
        n_poses: Random poses, for the fit and for the errors.
        seed: Of the poses.

    Raises:
        ConfigError: If the environment does not tell where end effector and target are.
    """
    env = make_env(config.env_id, config.env_kwargs, config.env_wrapper)()
    _, info = env.reset(seed=seed)
    for key in POINTS.values():
        if key not in info:
            raise ConfigError(f"{config.env_id} does not give info['{key}']; take a run of one of our environments")
    images, positions = collect(env, n_poses, seed)
    model = load_model(config, model_file)
    features = {
        "trained": features_of(model.policy, images),
        "untrained": features_of(untrained_model(config, seed=seed).policy, images),
    }
    errors = []
    for point, where in positions.items():
        if np.ptp(where, axis=0).max() < 1e-6:
            continue  # a target that never moves is no question
        errors += [_error(point, source, read_positions(values, where)) for source, values in features.items()]
        errors.append(_error(point, "a guess", read_positions(np.zeros((len(where), 1)), where)))
    apart = final_distances(model, env, eval_initial_states(config.env_id, config.env_kwargs))
    env.close()
    return [*errors, _error("end effector to target", "at the end of the test episodes", apart)]


def _error(point: str, source: str, distances: Floats) -> Error:
    median, quantile_95 = 100 * np.quantile(distances, (0.5, 0.95))
    return Error(point, source, float(median), float(quantile_95))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog="python -m benchmarks.analysis.depth", description="3-D positions read from a trained extractor."
    )
    parser.add_argument("run", metavar="RUN", help="the run's directory, e.g. logs/ddpg/WamStereoReachRandom-v0_1")
    parser.add_argument("--load-best", action="store_true", help="the best model instead of the last")
    parser.add_argument("--poses", type=int, default=5000, metavar="N", help="random poses (default: 5000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the poses (default: 0)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def depth_command(args: argparse.Namespace) -> int:
    """Measure a run and print the errors."""
    if args.poses < 100 or args.seed < 0:
        raise ConfigError(f"--poses must be at least 100 and --seed not negative, got {args.poses} and {args.seed}")
    config, _ = load_record(args.run)
    errors = probe(config, model_path(args.run, config.env_id, args.load_best), args.poses, args.seed)
    if args.json:
        print(json.dumps([error._asdict() for error in errors]))
        return 0
    print(f"{'':56}  median     95 %")
    for error in errors:
        print(f"{error.point + ', ' + error.source:56}{error.median:5.1f} cm  {error.quantile_95:5.1f} cm")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and measure; return the exit status."""
    return run_command(depth_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
