"""Unmodified rl-baselines3-zoo trains with our YAML, environment and policy."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.zoo
pytest.importorskip("rl_zoo3", reason='pip install -e ".[zoo]"')
ROOT = Path(__file__).parents[2]
# Monitor wants a tuple, which plain YAML cannot write; the zoo reads it from a Python expression.
SUCCESS = "monitor_kwargs:dict(info_keywords=('is_success',))"


@pytest.mark.parametrize("algo", ["ddpg", "dqn", "td3", "sac", "crossq", "tqc", "ppo"])
@pytest.mark.parametrize("env_id", ["WamStereoReach-v0", "KukaStereoReach-v0"])
def test_the_zoo_trains_200_steps(env_id: str, algo: str, logs: Path) -> None:
    if env_id != "WamStereoReach-v0" and algo not in ("ddpg", "dqn"):
        pytest.skip("one arm is enough")
    tiny = ["n_steps:50", "batch_size:50"] if algo == "ppo" else ["learning_starts:150"]
    command = [sys.executable, "-m", "rl_zoo3.train", "--algo", algo, "--env", env_id]
    command += ["--gym-packages", "sb3_stereo", "-conf", str(ROOT / "hyperparams" / f"{algo}.yml")]
    command += [
        "-n",
        "200",
        "-params",
        *tiny,
        SUCCESS,
        "--eval-freq",
        "-1",
        "--num-threads",
        "1",
        "-f",
        str(logs),
    ]
    subprocess.run(command, cwd=logs.parent, check=True, timeout=900)
    run = logs / algo / f"{env_id}_1"
    assert (run / f"{env_id}.zip").exists()
    assert "is_success" in (run / "0.monitor.csv").read_text()
