"""What a user gives is used, or refused in one sentence before anything is written; nothing is a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import fake_reach
import pytest
from tiny_training import QUICK, TINY

from sb3_stereo.commands import enjoy, evaluate
from sb3_stereo.commands import train as train_cli
from sb3_stereo.envs import plain_yaml
from sb3_stereo.errors import ConfigError, setting_up

HELPERS = Path(fake_reach.__file__).parent


def status(main: object, *arguments: str) -> int:
    """The exit status of a command, also where argparse leaves at once."""
    try:
        return main(list(arguments))  # type: ignore[operator, no-any-return]
    except SystemExit as leaving:
        assert isinstance(leaving.code, int)
        return leaving.code


PARAMS = [
    "gamma:2020-99-99",
    "gamma:" + "9" * 5000,
    "gamma:.nan",
    "gamma:1.5",
    "gamma:!!float abc",
    "gamma:&a [*a]",
    "batch_size:-1",
    "batch_size:0",
    "train_freq:0",
    "train_freq:[0,episode]",
    "buffer_size:0",
    "buffer_size:1000000000000000",
    "tau:-0.1",
    "learning_rate:-1",
    "learning_rate:lin_x",
    "learning_rate:lin_-1",
    "gradient_steps:-2",
    "policy_kwargs.net_arch:[a]",
    "policy_kwargs.net_arch:[0]",
    "policy_kwargs.net_arch:[1000000000]",
    "policy_kwargs.net_arch:{pi: [8, -8], qf: [8]}",
    "policy_kwargs.features_extractor_kwargs.n_filters:0",
    "policy_kwargs.optimizer_kwargs:{speed: 3}",
    "policy_kwargs:dict(net_arch=__import__('os').getcwd())",
    "policy_kwargs:dict(**{})",
    "policy:.x.y",
    "policy:a..b",
    "policy:[1]",
    "callback:.x",
    "callback:stable_baselines3.common.callbacks.EveryNTimesteps",
    "env_wrapper:gymnasium.wrappers.TimeLimit",
    "env_wrapper:gymnasium.wrappers.FilterObservation",
    "replay_buffer_class:stable_baselines3.HerReplayBuffer",
    "replay_buffer_class:HerReplayBuffer",
    "normalize:true",
    "noise_std:-1",
    "noise_std:.inf",
    "n_envs:0",
    "?:1",
    ":1",
]


@pytest.mark.parametrize("assignment", PARAMS)
def test_a_wrong_setting_is_one_sentence_and_leaves_no_directory(
    assignment: str, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(logs), "-n", "12", "--verbose", "0"]
    assert status(train_cli.main, *flags, "-params", *TINY, assignment) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert not list(logs.rglob("*_1"))


def test_settings_that_do_not_go_together_are_one_sentence_too(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(logs), "-n", "12", "--verbose", "0"]
    assert status(train_cli.main, *flags, "-params", *TINY, "n_envs:2", "train_freq:[1,episode]") == 2
    assert "You must use only one env when doing episodic training" in capsys.readouterr().err
    ppo = ["n_envs:1", "n_steps:0", "batch_size:5"]
    assert status(train_cli.main, "--algo", "ppo", *flags, "-params", *ppo) == 2
    assert capsys.readouterr().err == "error: PPO: n_steps must be at least 1, got 0\n"
    assert not list(logs.rglob("*_1"))


FLAGS = [
    ["-n", "0"],
    ["-n", "-5"],
    ["-n", "many"],
    ["--seed", "-2"],
    ["--save-freq", "0"],
    ["--eval-freq", "-3"],
    ["--n-eval-envs", "0"],
    ["--num-threads", "0"],
    ["--verbose", "-1"],
    ["-f", "x" * 5000],
    ["-f", "a\0b"],
    ["-f", ""],
    ["-f", "\udcff"],
    ["-conf", "y" * 300],
    ["-i", "z" * 5000],
    ["--gym-packages", ""],
    ["--gym-packages", ".foo"],
    ["--gym-packages", "a_module_that_raises"],
    ["--gym-packages", "a_module_that_leaves"],
    ["--env-kwargs", "tolerance:-1"],
    ["--env-kwargs", "max_episode_steps:0"],
]


@pytest.mark.parametrize("flag", FLAGS, ids=lambda flag: " ".join(flag)[:40])
def test_a_wrong_flag_is_one_sentence_and_leaves_no_directory(
    flag: list[str], logs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "a_module_that_raises.py").write_text("1 / 0")
    (tmp_path / "a_module_that_leaves.py").write_text("raise SystemExit(0)")
    monkeypatch.syspath_prepend(tmp_path)
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(logs), "-n", "12", "--verbose", "0", "-params", *TINY]
    assert status(train_cli.main, *flags, *flag) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert not list(logs.rglob("*_1"))


def test_a_log_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-n", "12", "--verbose", "0", "-params", *TINY]
    for where in (["-f", str(tmp_path / "file")], ["-f", str(tmp_path / "logs"), "-tb", str(tmp_path / "file")]):
        assert status(train_cli.main, *flags, *where) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1 and "Not a directory" in error
    assert not list((tmp_path / "logs").rglob("*_1"))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    logs = tmp_path_factory.mktemp("logs")
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(logs), "-n", "12", "--verbose", "0", "--seed", "1"]
    assert train_cli.main([*flags, "--eval-freq", "-1", "--n-eval-envs", "1", "-params", *TINY]) == 0
    return logs / "ddpg" / "FakeReach-v0_1"


@pytest.mark.parametrize(
    "flag",
    [
        ["--env-kwargs", "tolerance:-1"],
        ["--env-kwargs", "tolerence:1"],
        ["--env-kwargs", "tolerance:wide"],
        ["--seed", "-1"],
        ["--zoom", "nan"],
        ["--zoom", "1e9"],
        ["--n-episodes", "0"],
        ["--exp-id", "-1"],
    ],
    ids=" ".join,
)
def test_a_wrong_flag_of_enjoy_is_one_sentence(flag: list[str], run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(run.parents[1]), "-n", "5", "--no-render"]
    assert status(enjoy.main, *flags, *flag) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1


def test_evaluate_and_training_go_on_when_nobody_reads_their_output(run: Path, logs: Path) -> None:
    """As after `| head -1`: the reader closes the pipe."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HELPERS), os.environ.get("PYTHONPATH", "")])}
    flags = ["--env", fake_reach.ENV_ID, *QUICK, "-f", str(logs), "-n", "40", "--seed", "1", "--eval-freq", "10"]
    train = ["train", *flags, "--n-eval-envs", "1", "-params", *TINY]
    for command in (["evaluate", str(run), "--poses", "2", "--n-envs", "1", *QUICK], train):
        process = subprocess.Popen(
            [sys.executable, "-m", "sb3_stereo", *command],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        error = process.stderr.read()
        assert process.wait(timeout=240) == 0, error
        assert "Traceback" not in error and "BrokenPipe" not in error
    assert (logs / "ddpg" / "FakeReach-v0_1" / "FakeReach-v0.zip").is_file()


def test_evaluate_refuses_negative_numbers(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(evaluate.main, str(run), "--poses", "-1") == 2
    assert capsys.readouterr().err == "error: argument --poses: '-1' is no integer of at least 0 (see --help)\n"


def test_what_is_raised_while_setting_up_is_one_sentence_and_signals_are_not() -> None:
    for raised, sentence in (
        (ValueError("rho is -1; give a positive number"), "rho is -1; give a positive number"),
        (
            MemoryError("Unable to allocate 9 TiB"),
            "not enough memory to set up it (Unable to allocate 9 TiB); make it smaller",
        ),
        (PermissionError(13, "Permission denied"), "cannot set up it: [Errno 13] Permission denied"),
        (
            AssertionError(),
            "cannot set up it (AssertionError: no reason given); change its settings, "
            "or see where it happened with --verbose 2",
        ),
    ):
        with pytest.raises(ConfigError) as error, setting_up("it"):
            raise raised
        assert str(error.value) == sentence
    with pytest.raises(KeyboardInterrupt), setting_up("it"):
        raise KeyboardInterrupt


def test_aliases_cannot_make_a_short_text_large() -> None:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [f"{name}: &{name} [{', '.join(['*' + before] * 9)}]" for before, name in zip("abcdefgh", "bcdefghi")]
    with pytest.raises(ValueError, match=r"^it stands for more than 100000 values"):
        plain_yaml.parse("\n".join(lines))
    merged = ["a: &a {x: 1}"]
    merged += [
        f"{name}: &{name} {{<<: [{', '.join(['*' + before] * 9)}]}}" for before, name in zip("abcdefgh", "bcdefghi")
    ]
    with pytest.raises(ValueError, match=r"^it stands for more than 100000 values"):
        plain_yaml.parse("\n".join(merged))
    assert plain_yaml.parse("a: &a {x: 1}\nb: {<<: *a, y: 2}") == {"a": {"x": 1}, "b": {"x": 1, "y": 2}}
    assert plain_yaml.parse("[1e-3, '1e-3', 1E4]") == [0.001, "1e-3", 10_000.0]
