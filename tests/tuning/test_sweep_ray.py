"""Sweeps on a real Ray: trials that fail, a node that dies, a driver that is killed. Minutes on a busy machine."""

import math
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fake_reach
import pytest
import yaml

from sb3_stereo.tuning.config import load_sweep
from sb3_stereo.tuning.records import Trial, read_trials

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
CHEAP = {"n_timesteps": 30, "policy": "MlpPolicy", "policy_kwargs": {"net_arch": [8]}}
CHEAP |= {"learning_starts": 10, "batch_size": 4, "buffer_size": 50}
BASE = {
    "env": fake_reach.ENV_ID,
    "conf_file": "cheap.yml",
    "eval_freq": 10,
    "metric": {"name": "eval/mean_steps_capped", "goal": "minimize"},
}


class Session:
    """Commands whose processes, with all that they start, are known by a mark in their environment."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mark = uuid.uuid4().hex
        self.environment = os.environ | {"PYTHONPATH": str(ROOT / "tests" / "helpers"), "SWEEP_TEST": self.mark}
        (folder / "cheap.yml").write_text(yaml.safe_dump({"default": CHEAP}))

    def start(self, *flags: str, **content: Any) -> "subprocess.Popen[str]":
        file = self.folder / "tiny.yml"
        file.write_text(yaml.safe_dump(BASE | content))
        command = [sys.executable, "-m", "sb3_stereo", "sweep", str(file), "-f", str(self.folder / "logs")]
        command += ["--gym-packages", "fake_reach", "--device", "cpu", *flags]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, cwd=ROOT, env=self.environment, stdout=pipe, stderr=pipe, text=True)

    def run(self, *flags: str, **content: Any) -> tuple[int, str, str]:
        process = self.start(*flags, **content)
        try:
            out, err = process.communicate()
        finally:
            process.kill()
        return process.returncode, out, err

    @property
    def results(self) -> Path:
        return self.folder / "logs" / "sweeps" / "tiny"

    def trials(self) -> list[Trial]:
        return read_trials(load_sweep(self.folder / "tiny.yml"), self.results)

    def processes(self) -> list[int]:
        """All living processes that came from this session."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (folder / "environ").read_bytes():
                    found.append(int(folder.name))
            except OSError:  # it ended meanwhile, or is another user's
                continue
        return found


def wait_for(condition: Callable[[], Any], seconds: float, process: "subprocess.Popen[str] | None" = None) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.2)


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    made = Session(tmp_path)
    yield made
    try:
        wait_for(lambda: not made.processes(), 120)  # Ray's agents wait a minute for a cluster that was killed
    finally:
        for number in made.processes():
            os.kill(number, signal.SIGKILL)


def test_what_fails_is_retried_and_reported_and_the_rest_is_trained(session: Session) -> None:
    grid = {"method": "grid", "parameters": {"env_kwargs.tolerance": {"values": [0.25, -1]}}, "retries": 1}
    status, out, err = session.run("--workers", "2", **grid)
    assert status == 1
    assert "env_kwargs.tolerance -1, seed 0: attempt 1 failed and is repeated; " in out
    assert "env_kwargs.tolerance 0.25, seed 0: finished at step 30, " in out
    assert err.startswith("failed: env_kwargs.tolerance -1, seed 0: ")
    assert "tolerance must be positive, got -1" in err and err.endswith(
        "The same command tries what failed once more.\n"
    )
    assert [(trial.params["env_kwargs.tolerance"], trial.state) for trial in session.trials()] == [(0.25, "finished")]
    assert {path.name for path in session.folder.iterdir()} == {"cheap.yml", "tiny.yml", "logs"}


def test_bayes_trains_each_setting_with_each_seed_and_grows(session: Session) -> None:
    parameters = {"gamma": {"min": 0.1, "max": 0.9}, "policy_kwargs.net_arch": {"values": [[8], [4, 4]]}}
    bayes = {"method": "bayes", "parameters": parameters, "seeds": [4, 7]}
    assert session.run("--workers", "2", **bayes, n_trials=2)[0] == 0
    first = {trial.run.name: trial.params for trial in session.trials()}
    assert len(first) == 4
    assert session.run("--workers", "2", **bayes, n_trials=3)[0] == 0
    trials = session.trials()
    assert len(trials) == 6 and {trial.state for trial in trials} == {"finished"}
    assert len({(str(trial.params), trial.seed) for trial in trials}) == 6
    assert first.items() <= {trial.run.name: trial.params for trial in trials}.items()


def test_asha_stops_bad_trials_which_are_not_repeated(session: Session) -> None:
    # Tolerance decides how easy the task is, so the later trials are worse than the first.
    values = [0.9, 0.5, 0.1, 0.05]
    grid = {"method": "grid", "parameters": {"env_kwargs.tolerance": {"values": values}}}
    grid["early_terminate"] = {"type": "asha", "min_iter": 10, "eta": 2}
    status, _, err = session.run("--workers", "1", **grid)
    assert (status, err) == (0, "")
    states = {trial.params["env_kwargs.tolerance"]: trial.state for trial in session.trials()}
    assert states[0.9] == "finished" and states[0.05] == "stopped"
    before = {trial.run: trial.timesteps for trial in session.trials()}
    assert session.run(**grid)[0] == 0
    assert before == {trial.run: trial.timesteps for trial in session.trials()}


def test_a_file_for_wandb_is_swept_with_steps_hyperband_and_a_cap(session: Session) -> None:
    wandb = {"program": "train.py", "project": "reach", "name": "first", "run_cap": 4, "method": "random"}
    wandb["early_terminate"] = {"type": "hyperband", "min_iter": 1, "eta": 2}
    wandb["parameters"] = {
        "env_kwargs.tolerance": {"values": [0.9, 0.05], "probabilities": [0.5, 0.5]},
        "batch_size": {"distribution": "q_log_uniform_values", "min": 3, "max": 9, "q": 2},
        "learning_rate": {"distribution": "log_uniform", "min": -9, "max": -7},
    }
    status, out, err = session.run("--workers", "1", **wandb)
    assert (status, err) == (0, "")
    assert "Not used: name, program, project\n" in out
    trials = session.trials()
    assert len(trials) == 4 and {trial.state for trial in trials} <= {"finished", "stopped"}
    assert {trial.params["batch_size"] for trial in trials} <= {4, 6, 8}
    assert all(math.exp(-9) <= trial.params["learning_rate"] <= math.exp(-7) for trial in trials)


LONG = {"method": "grid", "parameters": {"gamma": {"values": [0.1, 0.9]}}, "seeds": [0, 1], "n_timesteps": 600}
LONG["eval_freq"] = 100
SAVE = ("--save-freq", "150")


def test_a_killed_driver_continues_and_repeats_nothing_finished(session: Session) -> None:
    process = session.start("--workers", "2", *SAVE, **LONG)
    try:
        wait_for(lambda: list(session.results.glob("ddpg/*/FakeReach-v0.zip")), 240, process)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    finished = [trial.run for trial in session.trials() if trial.state == "finished"]
    assert 1 <= len(finished) < 4
    files = {file: file.stat().st_mtime_ns for run in finished for file in run.glob("*.*")}
    status, *_ = session.run("--workers", "2", *SAVE, **LONG)
    assert status == 0
    trials = session.trials()
    assert sorted((trial.params["gamma"], trial.seed) for trial in trials) == [
        (gamma, seed) for gamma in (0.1, 0.9) for seed in (0, 1)
    ]
    assert {trial.state for trial in trials} == {"finished"}
    assert files == {file: file.stat().st_mtime_ns for file in files}
    assert len(list((session.results / "ddpg").iterdir())) == 4


def test_a_node_dies_and_every_trial_is_done_once(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    from ray.cluster_utils import Cluster

    for name in ("PYTHONPATH", "SWEEP_TEST"):  # for the nodes' workers
        monkeypatch.setenv(name, session.environment[name])
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    node = {"num_cpus": 1, "object_store_memory": 128 * 2**20}
    cluster = Cluster(initialize_head=True, head_node_args=node | {"include_dashboard": False})
    try:
        second = cluster.add_node(**node)
        process = session.start("--address", cluster.address, *SAVE, **LONG)
        running = lambda: sum(t.state == "unfinished" and t.timesteps > 0 for t in session.trials()) == 2  # noqa: E731
        wait_for(running, 240, process)
        cluster.remove_node(second, allow_graceful=False)
        out, err = process.communicate()
    finally:
        cluster.shutdown()
    assert process.returncode == 0, err
    assert "attempt 1 failed and is repeated" in out
    trials = session.trials()
    assert {trial.state for trial in trials} == {"finished"}
    assert len(trials) == len({(trial.params["gamma"], trial.seed) for trial in trials}) == 4
    assert len(list((session.results / "ddpg").iterdir())) == 4
