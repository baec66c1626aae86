"""Unmodified rl-baselines3-zoo trains with our YAML, environment and policy."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.zoo
pytest.importorskip("rl_zoo3", reason='pip install -e ".[zoo]"')
ROOT = Path(__file__).parent.parent
# Monitor wants a tuple, which plain YAML cannot write; the zoo reads it from a Python expression.
SUCCESS = "monitor_kwargs:dict(info_keywords=('is_success',))"


@pytest.mark.parametrize("algo", ["ddpg", "dqn"])
def test_the_zoo_trains_200_steps(algo: str, logs: Path) -> None:
    command = [sys.executable, "-m", "rl_zoo3.train", "--algo", algo, "--env", "WamStereoReach-v0"]
    command += ["--gym-packages", "sb3_stereo", "-conf", str(ROOT / "hyperparams" / f"{algo}.yml")]
    command += [
        "-n",
        "200",
        "-params",
        "learning_starts:150",
        SUCCESS,
        "--eval-freq",
        "-1",
        "--num-threads",
        "1",
        "-f",
        str(logs),
    ]
    subprocess.run(command, cwd=logs.parent, check=True, timeout=300)
    run = logs / algo / "WamStereoReach-v0_1"
    assert (run / "WamStereoReach-v0.zip").exists()
    assert "is_success" in (run / "0.monitor.csv").read_text()
