"""Run directories: new ones never collide, and what a run needs is found in it."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fake_reach
import pytest
import yaml

from sb3_stereo.config.schema import parse_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs import directory as runs
from sb3_stereo.runs.creation import create_run

ENV_ID = fake_reach.ENV_ID
CONFIG = parse_config(
    "ddpg", ENV_ID, {"n_timesteps": 10, "policy": "CnnPolicy", "gamma": 0.5, "train_freq": [1, "step"]}
)
ARGS = {"algo": "ddpg", "env": ENV_ID, "seed": 3}


def test_runs_are_numbered_from_one_as_in_the_zoo(logs: Path) -> None:
    assert [create_run(logs, CONFIG, ARGS).relative_to(logs) for _ in range(2)] == [
        Path("ddpg/FakeReach-v0_1"),
        Path("ddpg/FakeReach-v0_2"),
    ]
    assert runs.find_run(logs, "ddpg", ENV_ID).name == "FakeReach-v0_2"
    assert runs.find_run(logs, "ddpg", ENV_ID, exp_id=1).name == "FakeReach-v0_1"


def test_runs_that_start_together_get_directories_of_their_own(logs: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: create_run(logs, CONFIG, ARGS), range(32)))
    assert len(set(made)) == 32


def test_run_ten_is_later_than_run_nine(logs: Path) -> None:
    for i in (9, 10):
        (logs / "ddpg" / f"{ENV_ID}_{i}").mkdir(parents=True)
    assert runs.find_run(logs, "ddpg", ENV_ID).name == f"{ENV_ID}_10"


def test_the_saved_configuration_is_plain_yaml_and_reads_back_the_same(logs: Path) -> None:
    run = create_run(logs, CONFIG, ARGS)
    config, args = runs.load_record(run)
    assert (config, args["seed"]) == (CONFIG, 3)
    folder = run / ENV_ID
    assert (folder / "command.txt").read_text().strip()
    assert {"python", "sb3_stereo", "torch"} <= set(yaml.safe_load((folder / "versions.yml").read_text()))


def test_models_are_found_by_kind(logs: Path) -> None:
    run = create_run(logs, CONFIG, ARGS)
    for name in ("FakeReach-v0.zip", "best_model.zip", "rl_model_200_steps.zip", "rl_model_1000_steps.zip"):
        (run / name).touch()
    assert runs.model_path(run, ENV_ID).name == "FakeReach-v0.zip"
    assert runs.model_path(run, ENV_ID, best=True).name == "best_model.zip"
    assert runs.model_path(run, ENV_ID, checkpoint=200).name == "rl_model_200_steps.zip"
    assert runs.checkpoint_steps(run) == [200, 1000]


def test_what_is_missing_is_named(logs: Path) -> None:
    with pytest.raises(ConfigError) as error:
        runs.find_run(logs, "ddpg", ENV_ID)
    assert str(error.value) == (
        f"no run of FakeReach-v0 in '{logs / 'ddpg'}'; "
        f"train one with: python -m sb3_stereo train --algo ddpg --env FakeReach-v0 -f {logs}"
    )
    run = create_run(logs, CONFIG, ARGS)
    with pytest.raises(ConfigError) as error:
        runs.find_run(logs, "ddpg", ENV_ID, exp_id=7)
    assert str(error.value) == f"no run 7 of FakeReach-v0 in '{logs / 'ddpg'}'; runs are 1"
    with pytest.raises(ConfigError) as error:
        runs.model_path(run, ENV_ID)
    assert str(error.value) == (
        f"no model 'FakeReach-v0.zip' in '{run}'; models are: none (choose with --load-best or --load-checkpoint)"
    )
    with pytest.raises(ConfigError) as error:
        runs.load_record(logs)
    assert str(error.value) == f"'{logs}' is not a run directory; give one such as logs/ddpg/WamStereoReach-v0_1"


def test_the_last_checkpoint_is_the_one_with_most_steps(logs: Path) -> None:
    run = create_run(logs, CONFIG, ARGS)
    for step in (900, 1000, 20):
        (run / runs.checkpoint_name(step)).touch()
    assert runs.model_path(run, ENV_ID, checkpoint=runs.LAST_CHECKPOINT).name == "rl_model_1000_steps.zip"


def test_a_log_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError) as error:
        create_run(tmp_path / "file", CONFIG, ARGS)
    assert str(error.value) == f"cannot write to '{tmp_path / 'file'}' (Not a directory); choose a log folder with -f"
