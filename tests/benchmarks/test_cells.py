"""A cell is a trial like a sweep's: trained once, continued, retried, and recorded as soon as it ends."""

import argparse
import os
from pathlib import Path
from typing import Any

import fake_reach
import pytest

import benchmarks
from benchmarks.tables import cells
from benchmarks.tables.cells import Row, cell_lines, cell_training, read, train_missing
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.runs import status
from sb3_stereo.training import session
from sb3_stereo.training import trainer as training
from sb3_stereo.tuning import trials
from sb3_stereo.tuning.records import find_trial
from sb3_stereo.tuning.trials import run_trial

PARAMS = ("-params", "learning_starts:10", "batch_size:4", "dynamics_steps:0", "pretraining:null", "policy:CnnPolicy")
PARAMS += ("policy_kwargs:null", "buffer_size:50")
ARGUMENTS = ("--env", fake_reach.ENV_ID, "--gym-packages", "fake_reach", *PARAMS)
ROW = Row("tiny", "ddpg", "Tiny", ARGUMENTS, (20,))


def test_an_interrupted_cell_goes_on_and_a_finished_one_is_read(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def noted(name: str) -> Any:
        call = getattr(training, name)
        return lambda *args, **kwargs: calls.append(name) or call(*args, **kwargs)

    for name in ("train", "resume"):
        monkeypatch.setattr(trials, name, noted(name))
    monkeypatch.setattr(trials.tune, "report", lambda scores: None)
    monkeypatch.setattr(trials.sys, "orig_argv", [])
    monkeypatch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(4, seed=0))

    def lines(row: Row) -> list[dict[str, str]]:
        cell = cell_training(row, 3, logs)
        run_trial({}, lambda _: cell)
        run = find_trial(logs / "tiny" / "seed_3", row.config(), 3)
        assert run is not None
        return cell_lines(row, 3, run)

    first = lines(ROW)
    assert [line["timesteps"] for line in first] == ["20"] and first[0]["seed"] == "3"
    assert lines(ROW) == first
    (model,) = logs.rglob("FakeReach-v0.zip")
    status.mark(model.parent, status.NEW)  # as if killed before the end
    assert [line["mean_q"] for line in lines(ROW)] == [line["mean_q"] for line in first]
    assert calls == ["train", "resume"]
    (command,) = logs.rglob("command.txt")
    assert command.read_text().startswith("python train.py --algo ddpg --env FakeReach-v0 ")
    lines(Row("tiny", "ddpg", "Tiny", (*ARGUMENTS, "gamma:0.5"), (20,)))
    assert calls == ["train", "resume", "train"], "other settings are another training"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_cells_are_trained_on_ray_and_a_failing_one_stops_no_other(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(cells, "RETRIES", 1)
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(Path(fake_reach.__file__).parent), os.environ.get("PYTHONPATH", "")])
    )
    good, bad = (
        Row(name, "ddpg", "", (*ARGUMENTS, "--env-kwargs", f"tolerance:{tolerance}"), (10, 20))
        for name, tolerance in (("good", 0.5), ("bad", -1))
    )
    args = argparse.Namespace(address=None, workers=1, logs=logs)
    (failure,) = train_missing([bad, good], range(2, 3), args)
    out = capsys.readouterr().out
    assert failure.startswith("bad, seed 2: ") and "tolerance must be positive, got -1" in failure
    assert "bad, seed 2: attempt 1 failed and is repeated; " in out
    assert "1/2: good, seed 2, " in out
    assert [line["seed"] for line in read(good.record)] == ["2"] and good.done() == {2}
    assert read(bad.record) == []
    assert train_missing([good], range(2, 3), args) == []
