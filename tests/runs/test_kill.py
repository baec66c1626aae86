"""The real thing: SIGKILL at random moments, also while a checkpoint is written, and `--resume` until the end."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from comparing import assert_same, rows

from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.models import load_model

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="signals")]

TRAIN = [sys.executable, "-m", "sb3_stereo", "train"]
SETTINGS = [
    *("--seed", "5", "-n", "160", "--eval-freq", "-1", "--save-freq", "20", "--num-threads", "1", "--n-eval-envs", "1"),
    *("--device", "cpu", "-params", "learning_starts:40", "batch_size:16", "gradient_steps:1"),
]
N_KILLS = 4


def run_of(logs: Path) -> Path:
    return logs / "ddpg" / "WamStereoReach-v1_1"


def partials(run: Path) -> list[Path]:
    return list((run / "checkpoints").glob("partial"))


def start(*arguments: str) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([*TRAIN, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def kill(process: "subprocess.Popen[bytes]") -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()


def wait_for_training(process: "subprocess.Popen[bytes]", run: Path) -> None:
    """Wait until the process has begun to step, so that a kill hits the training and not the imports."""
    before = (run / "0.monitor.csv").stat().st_mtime_ns if (run / "0.monitor.csv").is_file() else 0
    while process.poll() is None:
        file = run / "0.monitor.csv"
        if file.is_file() and file.stat().st_mtime_ns > before:
            return
        time.sleep(0.01)


def kill_while_writing(process: "subprocess.Popen[bytes]", run: Path) -> bool:
    """Kill the process as soon as a checkpoint is being written; return whether one was."""
    while process.poll() is None:
        if partials(run):
            kill(process)
            return bool(partials(run))
        time.sleep(0.0002)
    return False


@pytest.mark.timeout(900)
def test_sigkill_at_any_moment_changes_nothing(tmp_path: Path) -> None:
    assert start(*SETTINGS, "-f", str(tmp_path / "undisturbed")).wait() == 0
    expected, run = run_of(tmp_path / "undisturbed"), run_of(tmp_path / "killed")

    moments = random.Random(0)
    process = start(*SETTINGS, "-f", str(tmp_path / "killed"))
    for _ in range(N_KILLS):
        wait_for_training(process, run)
        time.sleep(moments.uniform(0.0, 1.5))
        kill(process)
        process = start("--resume", str(run))
    kill_while_writing(process, run)
    assert start("--resume", str(run)).wait() in (0, 2)  # 2: it had ended before it could be killed

    models = [load_model(load_record(path)[0], path / "WamStereoReach-v1.zip", "cpu") for path in (run, expected)]
    assert_same(models[0].get_parameters(), models[1].get_parameters())
    assert rows(run / "evaluations.csv", "seconds") == rows(expected / "evaluations.csv", "seconds")
    assert rows(run / "0.monitor.csv", "t") == rows(expected / "0.monitor.csv", "t")
    assert not (run / "checkpoints").exists()
