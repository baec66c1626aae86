"""The commands, end to end on the fake environment: train, evaluate, enjoy, interrupt, and every error."""

import csv
import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import fake_reach
import numpy as np
import pytest
from stable_baselines3.common.monitor import load_results
from tiny_training import QUICK, SMALL, TINY, tiny_config

from sb3_stereo import __main__
from sb3_stereo.building.factory import make_model, make_training_env
from sb3_stereo.commands import enjoy, evaluate
from sb3_stereo.commands import train as train_cli
from sb3_stereo.config.schema import ALGORITHMS, load_config
from sb3_stereo.evaluation.scores import read_scores
from sb3_stereo.runs import load_record
from sb3_stereo.training import Options, train

ROOT = Path(__file__).parents[2]
ENV = ["--env", fake_reach.ENV_ID]


def run_train(logs: Path, *arguments: str, params: list[str] = TINY) -> int:
    flags = [*ENV, *QUICK, "--n-eval-envs", "1", "-f", str(logs), "--seed", "1"]
    return train_cli.main([*flags, "-params", *params, *arguments])


@pytest.mark.parametrize("algo", ["ddpg", "dqn"])
@pytest.mark.parametrize(("gradient_steps", "expected"), [(3, {1: 24, 4: 6}), (-1, {1: 8, 4: 8})])
def test_gradient_steps_mean_what_they_mean_in_sb3(algo: str, gradient_steps: int, expected: dict[int, int]) -> None:
    """Per step of all environments together; -1 is one per transition."""
    for n_envs, n_updates in expected.items():
        params = {"gradient_steps": gradient_steps, "learning_starts": 8, "pretraining": {"dynamics": 1}}
        config = tiny_config(algo, n_envs=n_envs, **params)
        model: Any = make_model(config, make_training_env(config, seed=0), seed=0, device="cpu")
        model.learn(16)
        assert model._n_updates == n_updates
        assert model.policy.dynamics.n_updates == 8 + 2 * (16 - 8) // n_envs


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_train_then_evaluate_then_enjoy(algo: str, logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if ALGORITHMS[algo] == "sb3_contrib":
        pytest.importorskip("sb3_contrib", reason='pip install -e ".[contrib]"')
    params = ["n_envs:1", "n_steps:10", "batch_size:5", "n_epochs:1", f"{SMALL}:4"] if algo == "ppo" else TINY
    arguments = ["--algo", algo, "-n", "40", "--eval-freq", "20", "--save-freq", "20"]
    assert run_train(logs, *arguments, params=params) == 0
    run = logs / algo / "FakeReach-v0_1"
    last_line = capsys.readouterr().out.splitlines()[-1]
    assert last_line.startswith("Done: 40 steps in ")
    assert last_line.endswith(f"; run: {os.path.relpath(run)}")
    assert {path.name for path in run.iterdir()} == {
        "0.monitor.csv",
        "FakeReach-v0",
        "FakeReach-v0.zip",
        "SHA256SUMS",
        "best_model.zip",
        "evaluations.csv",
        "rl_model_20_steps.zip",
        "rl_model_40_steps.zip",
    }
    rows = list(csv.DictReader((run / "evaluations.csv").open()))
    assert [row["timesteps"] for row in rows] == ["20", "40"]

    assert evaluate.main([str(run), "--json", "--num-threads", "1", "--n-envs", "1"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["n_poses"] == 100
    assert scores["success_rate"] == float(rows[-1]["success_rate"])
    assert scores["mean_steps_capped"] == float(rows[-1]["mean_steps_capped"])
    assert {"mean_steps_success", "mean_pixel_distance"} <= scores.keys()
    assert (
        evaluate.main([str(run), "--load-best", "--poses", "3", "--seed", "5", "--num-threads", "1", "--n-envs", "1"])
        == 0
    )
    assert f"{run / 'best_model.zip'}: reached the target from " in capsys.readouterr().out

    assert enjoy.main(["--algo", algo, *ENV, *QUICK, "-f", str(logs), "-n", "20", "--no-render"]) == 0
    assert " episodes, " in capsys.readouterr().out


def test_the_command_that_is_named_after_a_training_plays_its_best_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_train(tmp_path / "my logs", "-n", "12", "--eval-freq", "6") == 0
    run_train(tmp_path / "my logs", "-n", "12", "--eval-freq", "-1", "--verbose", "0")  # a later run
    (named,) = (line for line in capsys.readouterr().out.splitlines() if "watch it with" in line)
    python, m, package, command, *arguments = shlex.split(named.partition(" watch it with ")[2])
    assert (python, m, package, command) == ("python", "-m", "sb3_stereo", "enjoy")
    assert enjoy.main([*arguments, "-n", "5", "--no-render"]) == 0
    run = Path(os.path.relpath(tmp_path)) / "my logs" / "ddpg" / "FakeReach-v0_1"
    assert capsys.readouterr().out.startswith(f"Loading {run / 'best_model.zip'}\n")


def test_an_evaluation_plays_as_many_test_poses_as_are_asked_for(logs: Path) -> None:
    options = Options(seed=3, log_folder=str(logs), eval_freq=20, eval_episodes=7, verbose=0)
    result = train(tiny_config(), options)
    assert result.evaluation is not None and result.evaluation.n_poses == 7
    rows = list(csv.DictReader((result.run / "evaluations.csv").open()))
    assert [row["n_poses"] for row in rows] == ["7", "7"]


def test_a_search_is_what_sweeps_are_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert train_cli.main(["-optimize"]) == 2
    expected = "error: train makes one run; search with: python -m sb3_stereo sweep --help\n"
    assert capsys.readouterr().err == expected


def test_same_seed_learns_the_same(logs: Path) -> None:
    results = [train(tiny_config(), Options(seed=s, log_folder=str(logs), verbose=0)) for s in (3, 3, 4)]
    q_values = [result.evaluation.mean_q for result in results if result.evaluation]
    assert q_values[0] == q_values[1] != q_values[2]


def test_scoring_does_not_change_what_is_learnt(logs: Path) -> None:
    often, never = (
        train(tiny_config(), Options(seed=3, log_folder=str(logs), eval_freq=freq, verbose=0)).evaluation
        for freq in (7, -1)
    )
    assert often and never and often.scores() == never.scores()


def test_several_environments_in_processes(logs: Path) -> None:
    assert run_train(logs, "-n", "20", "--vec-env", "subproc", "--n-eval-envs", "2", params=[*TINY, "n_envs:2"]) == 0
    assert len(list((logs / "ddpg" / "FakeReach-v0_1").glob("*.monitor.csv"))) == 2


def test_a_linear_learning_rate_falls_to_zero() -> None:
    config = tiny_config(learning_rate="lin_0.01")
    model = make_model(config, make_training_env(config, seed=0), seed=0)
    assert [model.lr_schedule(progress) for progress in (1.0, 0.5, 0.0)] == pytest.approx([0.01, 0.005, 0.0])


def test_the_environment_gets_its_arguments_and_cap() -> None:
    config = load_config("ddpg", fake_reach.ENV_ID, env_kwargs={"tolerance": 0.5, "max_episode_steps": 2})
    env = make_training_env(config, seed=0)
    assert env.get_attr("tolerance") == [0.5]
    env.reset()
    steps = [env.step(np.ones((1, 4), np.float32))[2][0] for _ in range(2)]
    assert steps[-1]


def test_the_agent_may_be_evaluated_with_other_arguments_than_it_is_trained_with(logs: Path) -> None:
    arguments = ("--env-kwargs", "tolerance:0.001", "--eval-env-kwargs", "tolerance:5")
    assert run_train(logs, "-n", "20", *arguments, params=TINY) == 0
    run = logs / "ddpg" / "FakeReach-v0_1"
    config, _ = load_record(run)
    assert config.env_kwargs == {"tolerance": 0.001} and config.evaluated.env_kwargs == {"tolerance": 5}
    assert [scores["success_rate"] for scores in read_scores(run).values()] == [1.0]
    assert load_results(str(run))["is_success"].sum() == 0


def test_the_evaluated_environment_has_the_same_spaces(capsys: pytest.CaptureFixture[str], logs: Path) -> None:
    arguments = ["--env", "WamStereoReach-v1", "--eval-env-kwargs", "composite:channels"]
    assert train_cli.main([*arguments, "-f", str(logs), "-n", "20", "-params", "learning_starts:10"]) == 2
    assert capsys.readouterr().err == (
        "error: eval_env_kwargs (composite) make the observation_space Box(0, 255, (2, 42, 84), uint8), and the agent "
        "is trained with Box(0, 255, (1, 84, 84), uint8); set in env_kwargs what the agent sees or does\n"
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_saves_a_usable_run(number: signal.Signals, logs: Path) -> None:
    command = [sys.executable, "-u", "train.py", *ENV, *QUICK, "-f", str(logs), "-n", "100000", "-params", *TINY]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tests" / "helpers")}
    process = subprocess.Popen(
        [*command, "--save-freq", "20"],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background shell's children ignore it
    )
    run = logs / "ddpg" / "FakeReach-v0_1"
    try:
        while not (run / "rl_model_20_steps.zip").exists():
            assert process.poll() is None
        process.send_signal(number)
        output, _ = process.communicate(timeout=240)  # a busy machine
    finally:
        process.kill()
    assert process.returncode == 130
    assert output.splitlines()[-1].startswith(f"Interrupted by {number.name} after ")
    assert evaluate.main([str(run), "--poses", "2", "--num-threads", "1", "--n-envs", "1"]) == 0


def test_an_unseeded_run_prints_and_records_its_seed(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train_cli.main([*ENV, *QUICK, "-f", str(logs), "-n", "12", "-params", *TINY]) == 0
    seed = capsys.readouterr().out.split("seed ")[1].split(",")[0]
    assert f"seed: {seed}\n" in (logs / "ddpg" / "FakeReach-v0_1" / "FakeReach-v0" / "args.yml").read_text()


ERRORS = [
    (
        ["--algo", "a2c"],
        "unknown algorithm 'a2c' (did you mean 'sac'?); allowed are: crossq, ddpg, dqn, ppo, sac, td3, tqc",
    ),
    (["-params", "gamma=1"], "'gamma=1' is not of the form key:value, as in learning_starts:100"),
    (["-params", "gamma:[1]"], "DDPG: gamma must be a number, got [1]"),
    (["-conf", "no.yml"], "no hyper-parameter file 'no.yml'; check the path given with -conf"),
    (
        ["--gym-packages", "nowhere"],
        "cannot import the package 'nowhere' (No module named 'nowhere'); check --gym-packages",
    ),
    (["-i", "no.zip"], "no model 'no.zip'; give the zip file of one, such as the best_model.zip of a run"),
    (["--seed", "4294967296"], "--seed must be below 4294967296, got 4294967296"),
    (["--env-kwargs", "tolerance:-1"], "tolerance must be positive, got -1"),
    (
        ["--algo", "dqn", "-params", "env_wrapper:null"],
        "dqn needs Discrete actions, FakeReach-v0 has Box(-1.0, 1.0, (4,), float32); "
        "add the env_wrapper sb3_stereo.envs.wrappers.QuantizedActions",
    ),
    (
        ["-params", "policy_kwargs.shared_encoder:false", "policy_kwargs.share_features_extractor:true"],
        "share_features_extractor=True would train the encoder by the actor's loss; "
        "use shared_encoder=True, where the critic's loss trains it",
    ),
    (
        ["-params", "noise_type:null"],
        "annealed exploration needs DQN or Ornstein-Uhlenbeck action noise (noise_type: ornstein-uhlenbeck, "
        "noise_std: 0.5), got DDPG with None",
    ),
]


@pytest.mark.parametrize(("arguments", "message"), ERRORS)
def test_wrong_input_is_one_sentence_and_status_2(
    arguments: list[str], message: str, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train_cli.main([*ENV, "-f", str(logs), "-n", "20", "--verbose", "0", *arguments]) == 2
    assert capsys.readouterr().err == f"error: {message}\n"
    assert not list(logs.glob("*/*")), "a training that did not begin leaves no run"


def test_an_unknown_device_is_named(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train_cli.main([*ENV, "-f", str(logs), "--device", "abacus"]) == 2
    assert capsys.readouterr().err.startswith("error: device 'abacus' cannot be used (")


def test_an_unknown_flag_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        train_cli.main(["--colour", "red"])
    assert capsys.readouterr().err == "error: unrecognized arguments: --colour red (see --help)\n"


def test_playing_without_a_run_or_a_display_says_what_to_do(
    logs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert enjoy.main([*ENV, "-f", str(logs), "--no-render"]) == 2
    assert capsys.readouterr().err == (
        f"error: no run of FakeReach-v0 in '{logs / 'ddpg'}'; "
        f"train one with: python -m sb3_stereo train --algo ddpg --env FakeReach-v0 -f {logs}\n"
    )
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert enjoy.main([*ENV, "-f", str(logs)]) == 2
    assert capsys.readouterr().err == (
        "error: there is no display to open a window on; add --no-render or --video FILE.mp4\n"
    )


def test_the_module_lists_its_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert __main__.main(["--help"]) == 0
    output = capsys.readouterr().out
    assert all(f"  {name} " in output for name in __main__.COMMANDS)
    assert __main__.main(["--version"]) == 0
    assert capsys.readouterr().out == "sb3_stereo 0.1.0\n"
    assert __main__.main(["tarin"]) == 2
    commands = ", ".join(__main__.COMMANDS)
    assert capsys.readouterr().err == f"error: unknown command 'tarin'; commands are {commands}\n"
