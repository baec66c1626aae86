"""A training that is killed at any moment and resumed ends as if nothing had happened, bit for bit."""

import warnings
from pathlib import Path
from typing import Any

import fake_reach
import pytest
import torch as th
from comparing import assert_same, rows
from stable_baselines3.common.callbacks import BaseCallback

from sb3_stereo.commands import train as train_cli
from sb3_stereo.config.schema import DEFAULT_ENV, Config, load_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.runs import snapshots
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model
from sb3_stereo.runs.status import locked
from sb3_stereo.runs.training_state import variables
from sb3_stereo.training import Options, Result, resume, session, train

N_TIMESTEPS = 60
ROOT = Path(__file__).parents[2]


class Killed(BaseException):
    """What nobody catches."""


class Kill(BaseCallback):
    """Ends the process, as far as a test can, at the steps that are left in `at`."""

    at: list[int] = []  # noqa: RUF012

    def _on_step(self) -> bool:
        if self.at and self.num_timesteps >= self.at[0]:
            raise Killed(self.at.pop(0))
        return True


@pytest.fixture(autouse=True)
def few_initial_states(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(4, seed=0))


def config(algo: str = "ddpg", n_envs: int = 1, env_id: str = fake_reach.ENV_ID, **changes: Any) -> Config:
    """Our defaults with small networks, so that all that has a memory of its own takes part."""
    values = load_config(algo, env_id).plain()
    policy_kwargs = values["policy_kwargs"]
    policy_kwargs["features_extractor_kwargs"] |= {"n_filters": 4, "features_dim": 8, "embedding_dim": 3}
    tiny = {"learning_starts": 10, "buffer_size": 40 * n_envs, "gradient_steps": 1}
    if algo == "ppo":
        tiny = {"n_steps": 8, "n_epochs": 2}
    params = tiny | {"batch_size": 4, "n_envs": n_envs, "policy_kwargs": policy_kwargs} | changes
    params |= {"callback": [*(values["callback"] or ()), f"{__name__}.Kill"]}
    return load_config(algo, env_id, params=params, n_timesteps=N_TIMESTEPS)


def options(logs: Path, **changes: Any) -> Options:
    return Options(**{"seed": 3, "log_folder": str(logs), "eval_freq": 25, "save_freq": 8, "verbose": 0} | changes)


def killed_and_resumed(logs: Path, config: Config, options: Options, at: list[int]) -> Result:
    """Train; at every kill, resume."""
    Kill.at = list(at)
    try:
        return train(config, options)
    except Killed:
        (run,) = (logs / config.algo).iterdir()
    while True:
        try:
            return resume(run, verbose=0)
        except Killed:
            pass


def weights(run: Path) -> dict[str, Any]:
    config = load_record(run)[0]
    model = load_model(config, model_path(run, config.env_id), "cpu")
    return {**model.get_parameters(), **variables(model)}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Runs that nothing happened to, by algorithm and environments; trained once each."""
    runs: dict[tuple[str, int], Path] = {}

    def get(algo: str, n_envs: int) -> Path:
        if (algo, n_envs) not in runs:
            logs = tmp_path_factory.mktemp("undisturbed")
            runs[algo, n_envs] = killed_and_resumed(logs, config(algo, n_envs), options(logs), []).run
        return runs[algo, n_envs]

    return get


@pytest.mark.parametrize(
    ("algo", "n_envs", "at"),
    [
        ("ddpg", 1, [5]),  # before the first checkpoint
        ("ddpg", 1, [9]),  # before anything is learnt
        ("ddpg", 1, [17, 30, 30, 59]),  # again and again; after the buffer went round
        ("ddpg", 2, [21, 45]),
        ("dqn", 1, [26, 50]),
        ("dqn", 2, [33]),
    ],
)
def test_a_killed_training_ends_as_if_nothing_had_happened(
    algo: str, n_envs: int, at: list[int], logs: Path, undisturbed: Any
) -> None:
    expected = undisturbed(algo, n_envs)
    run = killed_and_resumed(logs, config(algo, n_envs), options(logs), at).run
    assert_same_runs(run, expected)


def assert_same_runs(run: Path, expected: Path) -> None:
    assert not Kill.at
    assert_same(weights(run), weights(expected))
    assert rows(run / "evaluations.csv", "seconds") == rows(expected / "evaluations.csv", "seconds")
    for monitor in expected.glob("*.monitor.csv"):
        assert rows(run / monitor.name, "t") == rows(monitor, "t")
    assert {path.name for path in run.iterdir()} == {path.name for path in expected.iterdir()}


def assert_nothing_happened(logs: Path, config: Config, at: list[int]) -> None:
    """Train with and without kills, and compare."""
    expected = killed_and_resumed(logs / "undisturbed", config, options(logs / "undisturbed"), [])
    assert_same_runs(killed_and_resumed(logs, config, options(logs), at).run, expected.run)


@pytest.mark.parametrize("algo", ["sac", "ppo"])
def test_other_learners_are_resumed_with_their_state_dependent_exploration_too(algo: str, logs: Path) -> None:
    assert_nothing_happened(logs, config(algo, 2, use_sde=True), [21, 45])


@pytest.mark.parametrize(
    "changes",
    [
        {"augmentation": {"begin": 10, "end": 30}},
        {"augmentation": {}, "env_kwargs": {"randomize": "default", "composite": "markers", "max_episode_steps": 7}},
    ],
    ids=["growing", "in random worlds"],
)
def test_augmented_images_and_random_worlds_are_resumed(changes: dict[str, Any], logs: Path) -> None:
    env_id = DEFAULT_ENV if "env_kwargs" in changes else fake_reach.ENV_ID
    assert_nothing_happened(logs, config("ddpg", 1, env_id=env_id, **changes), [21, 45])


@pytest.mark.slow
def test_a_training_in_mujoco_is_resumed(logs: Path) -> None:
    pytest.importorskip("mujoco")
    from sb3_stereo.envs.mujoco_opengl import check_drawing

    try:
        check_drawing()
    except ValueError as error:
        pytest.skip(str(error))
    kwargs = {"brake": False, "randomize": "default", "max_episode_steps": 7}
    assert_nothing_happened(logs, config("ddpg", 1, env_id="WamStereoReachMujoco-v0", env_kwargs=kwargs), [21, 45])


@pytest.mark.slow
def test_objects_that_are_held_are_resumed(logs: Path) -> None:
    task = {"phase": "grasp", "composite": "markers", "n_distractors": 1, "max_episode_steps": 7}
    assert_nothing_happened(logs, config("ddpg", 1, env_id="WamStereoPick-v0", env_kwargs=task), [21, 45])


GOALS = {"policy_kwargs": {"net_arch": [8]}, "policy": "MultiInputPolicy"}


@pytest.mark.parametrize(
    "changes",
    [
        GOALS | {"env_id": "WamStereoReachGoal-v0", "env_kwargs": {"max_episode_steps": 7}},
        GOALS
        | {"env_id": DEFAULT_ENV, "env_kwargs": {"composite": "dict", "max_episode_steps": 7}}
        | {"replay_buffer_kwargs": None, "pretraining": None},
    ],
    ids=["hindsight", "several images"],
)
def test_replay_buffers_of_maps_are_resumed(changes: dict[str, Any], logs: Path) -> None:
    env_id = changes["env_id"]
    params = {key: value for key, value in changes.items() if key != "env_id"}
    tiny = {"learning_starts": 10, "buffer_size": 40, "batch_size": 4, "callback": [f"{__name__}.Kill"]}
    tried = load_config("sac", env_id, params=tiny | params, n_timesteps=N_TIMESTEPS)
    assert_nothing_happened(logs, tried, [30, 50])


def test_a_snapshot_that_would_lack_the_infos_is_refused_at_the_start(logs: Path) -> None:
    hindsight = {"copy_info_dict": True, "n_sampled_goal": 4}
    params = {"learning_starts": 10, "replay_buffer_kwargs": hindsight, "env_kwargs": {"max_episode_steps": 5}}
    tried = load_config("sac", "WamStereoReachGoal-v0", params=params, n_timesteps=20)
    with pytest.raises(ConfigError, match=r"copy_info_dict is true.*--save-freq -1"):
        train(tried, options(logs))
    assert train(tried, options(logs, save_freq=-1, eval_freq=-1)).run.is_dir()


def test_hindsight_before_the_first_episode_ends_is_refused_at_the_start(logs: Path) -> None:
    tried = load_config("sac", "WamStereoReachGoal-v0", params={"learning_starts": 29}, n_timesteps=40)
    with pytest.raises(ConfigError, match=r"learning_starts is 29.*set learning_starts to at least 30"):
        train(tried, options(logs))


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["crossq", "ppo", "sac", "td3", "tqc"])
def test_every_learner_is_resumed_on_the_real_environment(algo: str, logs: Path) -> None:
    if algo in ("crossq", "tqc"):
        pytest.importorskip("sb3_contrib")
    assert_nothing_happened(logs, config(algo, env_id=DEFAULT_ENV), [17, 30, 59])


def test_tensorboard_has_no_gaps_and_nothing_twice(logs: Path) -> None:
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")

    def scores(folder: Path) -> list[tuple[int, float]]:
        (run,) = folder.glob("tb/*/DDPG_1")
        accumulator = events.EventAccumulator(str(run)).Reload()
        return [(event.step, event.value) for event in accumulator.Scalars("eval/mean_q")]

    for folder, at in ((logs / "a", []), (logs / "b", [30])):
        killed_and_resumed(folder, config(), options(folder, tensorboard_log=str(folder / "tb")), at)
    assert scores(logs / "a") == scores(logs / "b")
    assert [step for step, _ in scores(logs / "b")] == [25, 50, 60]


def killed_run(logs: Path, at: int = 30, **changes: Any) -> Path:
    Kill.at = [at]
    with pytest.raises(Killed):
        train(config(), options(logs, **changes))
    (run,) = (logs / "ddpg").iterdir()
    return run


def test_the_last_two_checkpoints_are_kept_and_none_after_the_end(logs: Path) -> None:
    run = killed_run(logs)
    assert sorted(path.name.partition("-")[0] for path in (run / "checkpoints").iterdir()) == ["step_16", "step_24"]
    resume(run, verbose=0)
    assert not (run / "checkpoints").exists()
    assert (run / "rl_model_24_steps.zip").is_file()


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_checkpoint_is_noticed_and_the_one_before_is_used(damage: str, logs: Path, undisturbed: Any) -> None:
    run = killed_run(logs)
    newest = max((run / "checkpoints").iterdir(), key=lambda path: path.name)
    content = bytearray(newest.read_bytes())
    middle = len(content) // 2
    newest.write_bytes(content[:middle] if damage == "cut" else content[:middle] + b"?" + content[middle + 1 :])
    with pytest.warns(UserWarning, match=r"step_24-.* is damaged: its digest is another one; trying the snapshot"):
        result = resume(run, verbose=0)
    assert_same(weights(result.run), weights(undisturbed("ddpg", 1)))


def test_a_kill_while_a_checkpoint_is_written_leaves_the_one_before(
    logs: Path, monkeypatch: pytest.MonkeyPatch, undisturbed: Any
) -> None:
    save = th.save

    def half(state: Any, file: Any, **kwargs: Any) -> None:
        save(state, file, **kwargs)
        if isinstance(state, dict) and state.get("files") and "step_16" in str(list(logs.rglob("*.pt"))):
            file.truncate(file.tell() // 2)
            raise Killed

    monkeypatch.setattr(th, "save", half)
    Kill.at = []
    with pytest.raises(Killed):
        train(config(), options(logs))
    monkeypatch.undo()
    (run,) = (logs / "ddpg").iterdir()
    (run / "checkpoints" / "partial").write_bytes(b"half")  # a real kill leaves it
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_same(weights(resume(run, verbose=0).run), weights(undisturbed("ddpg", 1)))


def test_a_checkpoint_is_read_without_running_anything(logs: Path) -> None:
    class Evil:
        def __reduce__(self) -> Any:
            return (Path.touch, (logs / "executed",))

    run = killed_run(logs)
    snapshots.save(run, 32, {"training": Evil()})
    with pytest.raises(
        ConfigError,
        match=r"step_32-.*' holds more than plain data, which is not loaded \(.*\); "
        "remove it, and the one before it is used$",
    ):
        resume(run, verbose=0)
    assert not (logs / "executed").exists()


def test_two_processes_cannot_train_one_run(logs: Path) -> None:
    run = killed_run(logs)
    with locked(run), pytest.raises(ConfigError) as error:
        resume(run, verbose=0)
    assert str(error.value) == f"another process trains '{run}' now; wait for it, or stop it first"


def test_the_command_resumes_and_says_when_there_is_nothing_to_do(
    logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = killed_run(logs)
    assert train_cli.main(["--resume", str(run), "--verbose", "0"]) == 0
    assert capsys.readouterr().out.startswith(f"Done: {N_TIMESTEPS} steps in ")
    assert train_cli.main(["--resume", str(run)]) == 2
    message = f"error: '{run}' has ended after {N_TIMESTEPS} steps; there is nothing to resume\n"
    assert capsys.readouterr().err == message
    assert train_cli.main(["--resume", str(run), "--seed", "3"]) == 2
    assert capsys.readouterr().err == "error: --resume takes the run's own settings, got 'seed' too; leave it out\n"
    assert train_cli.main(["--resume", str(logs)]) == 2
    assert capsys.readouterr().err == (
        f"error: '{logs}' is not a run directory; give one such as logs/ddpg/WamStereoReach-v0_1\n"
    )
