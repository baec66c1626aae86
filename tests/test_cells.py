"""A cell is trained once: an interrupted one goes on, and one that ended is only read."""

from collections.abc import Sequence
from pathlib import Path

import fake_reach
import pytest

from benchmarks import cells
from benchmarks.cells import Row, train_cell
from sb3_stereo import train as train_cli

PARAMS = ("-params", "learning_starts:10", "batch_size:4", "callback:null", "noise_type:null", "policy:CnnPolicy")
PARAMS += ("policy_kwargs:null", "buffer_size:50")
ARGUMENTS = ("--env", fake_reach.ENV_ID, "--gym-packages", "fake_reach", "--verbose", "0", *PARAMS)
ROW = Row("tiny", "ddpg", "Tiny", ARGUMENTS, (20,))


def test_an_interrupted_cell_goes_on_and_a_finished_one_is_read(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def train(arguments: Sequence[str], folder: Path) -> None:
        calls.append(arguments[0])
        assert train_cli.main(list(arguments)) == 0

    monkeypatch.setattr(cells, "train", train)
    lines = train_cell(ROW, 3, logs)
    assert [line["timesteps"] for line in lines] == ["20"] and lines[0]["seed"] == "3"
    assert train_cell(ROW, 3, logs) == lines
    (model,) = logs.rglob("FakeReach-v0.zip")
    model.unlink()  # as if killed before the end
    again = train_cell(ROW, 3, logs)
    assert [line["mean_q"] for line in again] == [line["mean_q"] for line in lines]
    assert calls == ["--algo", "--resume"]
    train_cell(Row("tiny", "ddpg", "Tiny", (*ARGUMENTS, "gamma:0.5"), (20,)), 3, logs)
    assert calls == ["--algo", "--resume", "--algo"], "other settings are another training"
