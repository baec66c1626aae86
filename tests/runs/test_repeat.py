"""With one thread a seed fixes a training to the last bit: over processes, however its environments are stepped."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.models import load_model

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

HELPERS = Path(__file__).parents[1] / "helpers"
COMMAND = [
    sys.executable,
    "-m",
    "sb3_stereo",
    "train",
    "--eval-freq",
    "-1",
    "--n-eval-envs",
    "1",
    "--verbose",
    "0",
]
COMMAND += ["--num-threads", "1", "--device", "cpu"]
PARAMS = ["learning_starts:10", "batch_size:8", "buffer_size:100"]
PARAMS += ["policy_kwargs.features_extractor_kwargs.n_filters:4"]
ENVS = {
    "fake": ["--env", "FakeReach-v0", "--gym-packages", "fake_reach", "-n", "40"],
    "real": ["-n", "40", "--env-kwargs", "rho:50"],  # a goal that is soon reached: episodes end, and begin at random
}


def trained(logs: Path, env: str, seed: int, vec_env: str, n_envs: int) -> dict[str, Any]:
    """The parameters that a training in an interpreter of its own has saved."""
    flags = ["--seed", str(seed), "--vec-env", vec_env, "-f", str(logs), *ENVS[env]]
    subprocess.run(
        [*COMMAND, *flags, "-params", *PARAMS, f"n_envs:{n_envs}"],
        check=True,
        cwd=Path(__file__).parents[1] / "helpers",
    )
    (run,) = (logs / "ddpg").iterdir()
    config = load_record(run)[0]
    parameters: dict[str, Any] = load_model(config, next(run.glob("*Reach-v[01].zip")), "cpu").get_parameters()
    return parameters


def same(one: Any, other: Any) -> bool:
    """Whether two trees of tensors are equal, bit for bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return bool((one == other).all()) if hasattr(one, "shape") else bool(one == other)


@pytest.mark.parametrize("env", ENVS)
def test_equal_seeds_give_equal_weights_over_processes(env: str, tmp_path: Path) -> None:
    one, again, other = (trained(tmp_path / str(i), env, seed, "dummy", 1) for i, seed in enumerate((3, 3, 4)))
    assert same(one, again)
    assert not same(one, other)


@pytest.mark.parametrize("env", ENVS)
def test_two_environments_in_workers_are_the_two_in_one_process(env: str, tmp_path: Path) -> None:
    inside, outside = (trained(tmp_path / vec_env, env, 3, vec_env, 2) for vec_env in ("dummy", "subproc"))
    assert same(inside, outside)
