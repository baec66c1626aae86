"""A sweep says how far it is: steps of all trials, how many ended, the best score so far."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tiny_training import tiny_config

pytest.importorskip("ray", reason='pip install -e ".[sweep]"')

from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.creation import create_run
from sb3_stereo.training import Options
from sb3_stereo.tuning.config import Metric
from sb3_stereo.tuning.progress import Progress, played_steps
from sb3_stereo.tuning.trials import Training

METRIC = Metric("eval/success_rate", "maximize")


def trial(number: int, status: str, result: dict[str, Any] | None = None) -> Any:
    return SimpleNamespace(trial_id=str(number), status=status, config={"seed": number}, last_result=result)


@pytest.fixture
def progress(logs: Path) -> Progress:
    def make_training(suggestion: Any) -> Training:
        if suggestion["seed"] == 9:
            raise ConfigError("these values do not go together")
        options = Options(seed=suggestion["seed"], log_folder=str(logs))
        return Training("a", tiny_config(n_timesteps=100), options, {}, (), METRIC)

    return Progress(make_training, n_trials=5)


def write_monitor(folder: Path, *lengths: int, cut: str = "") -> None:
    lines = ["#{}", "r,l,t", *(f"0.5,{length},1.0" for length in lengths)]
    (folder / "0.monitor.csv").write_text("\n".join(lines) + "\n" + cut)


def test_steps_are_those_of_ended_episodes_in_all_environments(tmp_path: Path) -> None:
    write_monitor(tmp_path, 30, 4, cut="0.5,1")
    (tmp_path / "1.monitor.csv").write_text("#{}\nr,l,t\n0.1,7,2.0\n")
    (tmp_path / "2.monitor.csv").write_text("")
    assert played_steps(tmp_path) == 30 + 4 + 7


def test_steps_of_all_trials_are_counted(
    progress: Progress, logs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = create_run(logs, tiny_config(n_timesteps=100), {"seed": 2, "algo": "ddpg", "env": "FakeReach-v0"})
    write_monitor(run, 20, 5)
    shown: list[tuple[int, str]] = []
    trials = [
        trial(1, "TERMINATED", {METRIC.name: 0.5}),
        trial(2, "RUNNING", {}),
        trial(3, "PENDING"),
        trial(9, "ERROR"),
    ]
    progress.show(trials)
    assert progress._bar is not None and progress._bar.total == 500
    monkeypatch.setattr(progress._bar, "update", lambda done, note="": shown.append((done, note)))
    progress.show(trials)
    assert shown == [(125, "1 of 5 trials ended, 1 running, best eval/success_rate so far 0.5")]
    progress.on_experiment_end(trials)


def test_the_best_score_is_the_metrics(progress: Progress) -> None:
    results = ({METRIC.name: 0.25}, {METRIC.name: float("nan")}, {METRIC.name: 0.75}, {})
    pairs = [(trial(n, "RUNNING", result), progress.make_training({"seed": n})) for n, result in enumerate(results)]
    assert progress.note(pairs) == "0 of 5 trials ended, 4 running, best eval/success_rate so far 0.75"
