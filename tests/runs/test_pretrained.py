"""The agents that ship with the package reach the target, and are what a run has learnt."""

import io
import json
import shutil
import zipfile
from importlib.util import find_spec
from pathlib import Path

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from comparing import assert_same
from tiny_training import QUICK, TINY

import sb3_stereo
from sb3_stereo.building.factory import make_env
from sb3_stereo.commands import enjoy, evaluate, train
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import evaluate as score
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model
from sb3_stereo.runs.pretrained import export, pretrained_names, pretrained_run

SHIPPED = pretrained_names()
SUCCESS = {"PandaStereoReach-v1": 0.85}  # what is asked of an agent on its test poses, if it is not 0.99


def test_one_ships_for_the_default_environment() -> None:
    assert ("ddpg", "WamStereoReach-v1") in SHIPPED


@pytest.mark.parametrize(("algo", "env_id"), SHIPPED)
def test_it_is_small_and_its_record_is_whole(algo: str, env_id: str) -> None:
    run = pretrained_run(algo, env_id)
    config, args = load_record(run)
    assert (config.algo, config.env_id) == (algo, env_id)
    assert model_path(run, env_id).stat().st_size < 1e6
    scores = json.loads((run / "score.json").read_text())
    assert scores["n_poses"] == 100
    assert scores["success_rate"] >= SUCCESS.get(env_id, 0.99)
    texts = [file.read_text() for file in run.rglob("*") if file.suffix in (".yml", ".csv", ".json")]
    assert not any("/" in text for text in texts), "a path of the machine that trained it"
    assert args["log_folder"] == "logs"


@pytest.mark.parametrize(("algo", "env_id"), SHIPPED)
def test_it_reaches_the_target_from_poses_of_its_own(algo: str, env_id: str) -> None:
    config, _ = load_record(pretrained_run(algo, env_id))
    env_fn = make_env(env_id, config.env_kwargs, config.env_wrapper)
    scores = score(sb3_stereo.load_pretrained(env_id, algo, "cpu"), env_fn, random_initial_states(20, seed=7))
    assert scores.success_rate >= SUCCESS.get(env_id, 0.99) - 0.15
    assert scores.mean_steps_success < 8


def test_another_environment_is_one_sentence_that_lists_those_that_ship() -> None:
    with pytest.raises(ConfigError) as error:
        sb3_stereo.load_pretrained("KukaStereoReach-v0")
    assert "WamStereoReach-v1" in str(error.value)
    assert "train --algo ddpg --env KukaStereoReach-v0" in str(error.value)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of a second."""
    flags = ["--env", fake_reach.ENV_ID, "-n", "12", "--eval-freq", "12", "--n-eval-envs", "1", *QUICK]
    assert train.main([*flags, "-f", str(tmp_path / "logs"), "-params", *TINY]) == 0
    (found,) = (tmp_path / "logs" / "ddpg").iterdir()
    return found


def test_an_exported_agent_acts_as_the_run_s_up_to_half_precision(run: Path, tmp_path: Path) -> None:
    exported = export(run, tmp_path / "shipped")
    (config, _), (recorded, _) = load_record(exported), load_record(run)
    assert config == recorded
    small, large = model_path(exported, config.env_id), model_path(run, config.env_id)
    assert small.stat().st_size < large.stat().st_size / 3
    model, original = load_model(config, small, "cpu"), load_model(config, large, "cpu")
    for name, weight in original.policy.state_dict().items():
        found = model.policy.state_dict()[name]
        assert found.dtype == weight.dtype
        assert_same(found, weight.half().to(weight.dtype))
    observation, _ = gym.make(fake_reach.ENV_ID).reset(seed=3)
    np.testing.assert_allclose(model.predict(observation)[0], original.predict(observation)[0], atol=0.02)


def test_a_changed_agent_is_refused(run: Path, tmp_path: Path) -> None:
    exported = export(run, tmp_path / "shipped")
    config, _ = load_record(exported)
    path = model_path(exported, config.env_id)
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(ConfigError, match="was changed after it was saved"):
        load_model(config, path, "cpu")


def test_half_precision_stands_for_single_precision_alone(run: Path, tmp_path: Path) -> None:
    exported = export(run, tmp_path / "shipped")
    config, _ = load_record(exported)
    path = model_path(exported, config.env_id)
    state = th.load(io.BytesIO(zipfile.ZipFile(path).read("policy.pth")), weights_only=True)
    state["dynamics.n_updates"] = state["dynamics.n_updates"].half()
    content = io.BytesIO()
    th.save(state, content)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("policy.pth", content.getvalue())
    (exported / "SHA256SUMS").unlink()
    with pytest.raises(ConfigError, match=r"n_updates' is float16 \[\], and these networks have int64 \[\]"):
        sb3_stereo.runs.models.load_weights(load_model(config, model_path(run, config.env_id)), path, trust=True)


def test_enjoy_plays_it_where_there_is_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--no-render", "--n-episodes", "2", "-f", str(tmp_path), "--num-threads", "1"]
    assert enjoy.main(flags) == 0
    printed = capsys.readouterr().out
    assert "No run of WamStereoReach-v1" in printed
    assert "2 episodes, 2 reached the target (100 %)" in printed
    assert enjoy.main([*flags, "--load-best"]) == 2, "that names a model of a run"
    assert "no run of WamStereoReach-v1" in capsys.readouterr().err


def test_enjoy_prefers_a_run_unless_told_otherwise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(pretrained_run("ddpg", "WamStereoReach-v1"), tmp_path / "ddpg" / "WamStereoReach-v1_4")
    flags = ["--no-render", "-n", "1", "-f", str(tmp_path), "--num-threads", "1"]
    assert enjoy.main(flags) == 0
    assert "WamStereoReach-v1_4" in capsys.readouterr().out
    assert enjoy.main([*flags, "--pretrained"]) == 0
    assert "WamStereoReach-v1_4" not in capsys.readouterr().out


def test_evaluate_takes_a_run_or_the_agent_that_ships(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(["--pretrained", "--poses", "3", "--n-envs", "1", "--json", "--num-threads", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["success_rate"] == 1.0
    for wrong in ([], ["logs/x", "--pretrained"]):
        with pytest.raises(SystemExit) as stopped:
            evaluate.main(wrong)
        assert stopped.value.code == 2


@pytest.mark.skipif(find_spec("mujoco") is None, reason="needs the extra [mujoco]")
def test_it_plays_the_same_task_in_another_simulator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twin = "WamStereoReachMujoco-v0"
    flags = ["--no-render", "--n-episodes", "2", "-f", str(tmp_path), "--num-threads", "1"]
    assert enjoy.main([*flags, "--env", twin]) == 0
    printed = capsys.readouterr().out
    assert f"No run of {twin}" in printed and "2 episodes, 2 reached the target (100 %)" in printed
    few = ["--poses", "2", "--n-envs", "1", "--json", "--num-threads", "1"]
    assert evaluate.main(["--pretrained", twin, *few]) == 0
    named = json.loads(capsys.readouterr().out)
    assert evaluate.main(["--pretrained", "--env", twin, *few]) == 0
    assert json.loads(capsys.readouterr().out) == named
    assert evaluate.main(["--pretrained", *few]) == 0
    assert json.loads(capsys.readouterr().out) != named, "the simulators are not the same to the last digit"


def test_a_training_begins_with_it(tmp_path: Path) -> None:
    flags = ["-i", "pretrained", "-n", "1", "--eval-freq", "-1", "--save-freq", "-1", "--num-threads", "1"]
    assert train.main([*flags, "-f", str(tmp_path), "--device", "cpu", "--env-kwargs", "max_episode_steps:1"]) == 0
    (run,) = (tmp_path / "ddpg").iterdir()
    config, args = load_record(run)
    trained = load_model(config, model_path(run, config.env_id), "cpu")
    shipped = sb3_stereo.load_pretrained("WamStereoReach-v1", device="cpu")
    assert_same(trained.policy.state_dict(), shipped.policy.state_dict())
    assert args["trained_agent"].endswith("WamStereoReach-v1.zip")
