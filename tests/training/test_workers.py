"""A process that steps an environment and dies ends a training with one sentence, and leaves a checkpoint only."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import fake_reach
import gymnasium as gym
import psutil
import pytest

from sb3_stereo.config.schema import Config, load_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import how_to_resume
from sb3_stereo.runs.snapshots import newest
from sb3_stereo.training import Options, train

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")

SMALL = "policy_kwargs.features_extractor_kwargs.n_filters"
TINY = {"learning_starts": 10, "batch_size": 4, "buffer_size": 50, "n_envs": 2, SMALL: 4}
N_KILLS = 2


class Dies(gym.Wrapper[Any, Any, Any, Any]):
    """Kills its process, if that is not the main one, after some steps."""

    def __init__(self, env: gym.Env[Any, Any], after: int) -> None:
        super().__init__(env)
        self.left = after

    def step(self, action: Any) -> Any:
        self.left -= 1
        if self.left < 0 and multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)


def dying(after: int) -> Config:
    wrapper = [{f"{__name__}.Dies": {"after": after}}]
    return load_config("ddpg", fake_reach.ENV_ID, params=TINY | {"env_wrapper": wrapper}, n_timesteps=200)


@pytest.mark.parametrize(
    ("after", "where"),
    [(30, {"vec_env": "subproc", "eval_freq": -1}), (3, {"n_eval_envs": 2, "eval_freq": 50})],
    ids=["training", "scoring"],
)
def test_a_dead_worker_ends_the_training_with_one_sentence(after: int, where: dict[str, Any], logs: Path) -> None:
    with pytest.raises(ConfigError) as error:
        train(dying(after), Options(seed=0, log_folder=str(logs), save_freq=20, verbose=0, **where))
    (run,) = (logs / "ddpg").iterdir()
    assert str(error.value) == (
        "a process that steps an environment died (SIGKILL); see that there is memory for it, then "
        + how_to_resume(run)
    )
    assert newest(run) is not None
    assert not multiprocessing.active_children()


def test_wrong_options_are_said_before_workers_start(logs: Path) -> None:
    config = load_config("ddpg", fake_reach.ENV_ID, params=TINY, env_kwargs={"tolerance": -1})
    with pytest.raises(ConfigError) as error:
        train(config, Options(seed=0, log_folder=str(logs), vec_env="subproc", verbose=0))
    assert str(error.value) == "tolerance must be positive, got -1"


def shared_memory() -> set[str]:
    return {name for name in os.listdir("/dev/shm") if not name.startswith("pym")}


def workers(process: "subprocess.Popen[str]") -> list[psutil.Process]:
    """The processes that the fork server has started."""
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if child.ppid() != process.pid]


def wait_for_checkpoint(process: "subprocess.Popen[str]", run: Path, known: set[Path]) -> set[Path]:
    while process.poll() is None:
        found = set((run / "checkpoints").glob("*.pt"))
        if found - known:
            return found
        time.sleep(0.01)
    raise AssertionError(f"it ended before a checkpoint: {process.communicate()}")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_killed_workers_leave_no_process_and_no_shared_memory_and_the_run_goes_on(logs: Path) -> None:
    """The command itself on the real environment: SIGKILL for one worker after each new checkpoint."""
    run = logs / "ddpg" / "WamStereoReach-v1_1"
    command = [sys.executable, "-m", "sb3_stereo", "train"]
    first = ["--seed", "1", "-n", "120", "-f", str(logs), "--vec-env", "subproc", "--save-freq", "20"]
    first += ["--num-threads", "1", "--eval-freq", "-1", "--n-eval-envs", "1", "--device", "cpu"]
    first += ["--env-kwargs", "rho:100"]  # a goal that is soon reached: the score at the end takes seconds
    first += ["-params", "n_envs:2", "learning_starts:20", "batch_size:8", "gradient_steps:1", f"{SMALL}:4"]
    arguments, known, before = first, set[Path](), shared_memory()
    for kill in range(N_KILLS):
        process = subprocess.Popen([*command, *arguments], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        known |= wait_for_checkpoint(process, run, known)
        family = psutil.Process(process.pid).children(recursive=True)
        workers(process)[kill % 2].kill()
        _, message = process.communicate(timeout=300)
        sentence = "a process that steps an environment died (SIGKILL); see that there is memory for it, then "
        assert message.splitlines()[-1] == f"error: {sentence}{how_to_resume(run)}"
        assert "Traceback" not in message
        assert process.returncode == 2
        gone, alive = psutil.wait_procs(family, timeout=60)  # a busy machine
        assert gone and not alive
        arguments = ["--resume", str(run)]
    assert shared_memory() <= before
    assert subprocess.run([*command, *arguments], stdout=subprocess.DEVNULL).returncode == 0
