"""Trackers are told what SB3 logs, and a run that is resumed goes on in theirs."""

from pathlib import Path
from typing import Any

import pytest
from tiny_training import tiny_config

from sb3_stereo.commands import train as train_cli
from sb3_stereo.errors import ConfigError
from sb3_stereo.training import Options, train
from sb3_stereo.training.tracking import ID_FILE, known_id, make_tracker, numbers


def options(logs: Path, **changes: Any) -> Options:
    known = {"seed": 3, "log_folder": str(logs), "eval_freq": 15, "eval_episodes": 2, "verbose": 0}
    return Options(**{**known, **changes})


def test_numbers_are_told_and_nothing_else() -> None:
    values = {"a": 1, "b": 2.5, "c": "text", "d": 3.0}
    assert numbers(values, {"d": ("tracker",), "a": ("stdout",), "b": None}) == {"a": 1.0, "b": 2.5}  # type: ignore[dict-item]


def test_without_a_tracker_nothing_is_told_and_nothing_is_left(logs: Path) -> None:
    run = train(tiny_config(), options(logs)).run
    assert make_tracker(run, tiny_config(), options(logs)) is None and not (run / ID_FILE).exists()


def test_mlflow_holds_the_settings_and_the_scores(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mlflow", reason='pip install -e ".[mlflow]"')
    from mlflow.tracking import MlflowClient

    monkeypatch.setenv("MLFLOW_TRACKING_URI", (tmp_path / "mlflow").as_uri())
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    result = train(tiny_config(), options(logs, track="mlflow", wandb_project_name="reach", wandb_tags=("a",)))
    number = known_id(result.run)
    assert number is not None
    client = MlflowClient()
    run = client.get_run(number)
    experiment = client.get_experiment_by_name("reach")
    assert experiment is not None and run.info.experiment_id == experiment.experiment_id
    assert run.info.status == "FINISHED" and run.data.tags["a"] == "true"
    assert run.data.params["seed"] == "3" and run.data.params["policy_kwargs.n_critics"] == "2"
    history = client.get_metric_history(number, "eval/success_rate")
    assert [metric.step for metric in history] == [15, 30]
    assert result.evaluation is not None and history[-1].value == result.evaluation.success_rate
    tracker = make_tracker(result.run, tiny_config(), options(logs, track="mlflow"))
    assert tracker is not None
    tracker.write({"later": 1.0}, {}, 40)
    tracker.close()
    assert [metric.value for metric in client.get_metric_history(number, "later")] == [1.0]


def test_weights_and_biases_keeps_an_offline_run(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wandb = pytest.importorskip("wandb", reason='pip install -e ".[track]"')
    monkeypatch.setenv("WANDB_MODE", "offline")
    result = train(tiny_config(), options(logs, track="wandb", wandb_project_name="reach", wandb_tags=("atag",)))
    wandb.teardown()  # its service writes the file's last records after finish() has returned
    number = known_id(result.run)
    (file,) = (result.run / "wandb").glob(f"offline-run-*/run-{number}.wandb")
    content = file.read_bytes()  # protobuf, whose texts stand there as they are
    assert content.count(b"eval/mean_steps_capped") >= 2 and result.evaluation is not None
    for text in ("reach", "atag", "policy_kwargs.n_critics", str(result.evaluation.mean_steps_capped)):
        assert text.encode() in content


def test_a_tracker_that_is_not_installed_is_named_with_its_extra(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "wandb", None)
    with pytest.raises(ConfigError) as caught:
        train(tiny_config(), options(logs, track="wandb"))
    assert str(caught.value) == '--track wandb needs wandb; install it with: pip install "sb3_stereo[track]"'
    assert not list((logs / "ddpg").glob("FakeReach*")), "a run that never began leaves nothing"


def test_the_zoos_flags_reach_the_options() -> None:
    flags = ["--track", "--wandb-project-name", "p", "--wandb-entity", "e", "-tags", "a", "b"]
    made = train_cli.make_options(train_cli.make_parser().parse_args([*flags, "--seed", "1"]))
    assert (made.track, made.wandb_project_name, made.wandb_entity, made.wandb_tags) == ("wandb", "p", "e", ("a", "b"))
