"""Runs that are damaged, copied, moved or old, and what is said of them."""

import os
import shutil
import time
import warnings
from pathlib import Path
from typing import Any

import pytest
import torch as th
import yaml
from comparing import assert_same, assert_same_runs, rows, weights
from stable_baselines3.common.callbacks import BaseCallback
from tiny_training import tiny_config

from sb3_stereo.commands import train as train_cli
from sb3_stereo.config.schema import Config
from sb3_stereo.console import command_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.runs import creation, snapshots, status
from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.files import sha256
from sb3_stereo.training import Options, Result, resume, session, train

ENV = "FakeReach-v0"


class Killed(BaseException):
    """What nobody catches."""


class Kill(BaseCallback):
    """Ends the process, as far as a test can, once at a step."""

    at: int | None = None

    def _on_step(self) -> bool:
        if self.num_timesteps == Kill.at:
            Kill.at = None
            raise Killed
        return True


@pytest.fixture(autouse=True)
def few_initial_states(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(3, seed=0))


def config() -> Config:
    plain = tiny_config(n_timesteps=24, learning_starts=4, gradient_steps=1)
    return tiny_config(
        n_timesteps=24,
        learning_starts=4,
        gradient_steps=1,
        callback=[*(plain.plain()["callback"] or ()), f"{__name__}.Kill"],
    )


def options(logs: Path, **changes: Any) -> Options:
    default = {"seed": 3, "eval_freq": 10, "save_freq": 8, "device": "cpu", "verbose": 0}
    return Options(log_folder=str(logs), **{**default, **changes})


def killed(logs: Path, at: int = 19, **changes: Any) -> Path:
    """A run that was killed: at step 19 after the snapshot at 16."""
    Kill.at = at
    with pytest.raises(Killed):
        train(config(), options(logs, **changes), {"num_threads": 1})
    return logs / "ddpg" / f"{ENV}_1"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(3, seed=0))
        return train(config(), options(tmp_path_factory.mktemp("logs"))).run


@pytest.fixture(scope="module")
def killed_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(3, seed=0))
        return killed(tmp_path_factory.mktemp("logs"))


@pytest.fixture
def run(killed_once: Path, tmp_path: Path) -> Path:
    """A killed run of one's own."""
    return Path(shutil.copytree(killed_once, tmp_path / killed_once.name))


def resume_quietly(run: Path) -> Result:
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        return resume(run, verbose=0)


@pytest.mark.parametrize(("before", "after"), [(0, 1), (1, 0), (0, 2)])
def test_a_run_is_resumed_with_another_verbosity(before: int, after: int, logs: Path, undisturbed: Path) -> None:
    run = killed(logs, verbose=before)
    assert train_cli.main(["--resume", str(run), "--verbose", str(after)]) == 0
    assert_same_runs(run, undisturbed)


PUT_BACK = "' was deleted, cut or changed; it is put back as it was at step 16"


@pytest.mark.parametrize("damage", ["deleted", "cut", "changed"])
@pytest.mark.parametrize("name", ["0.monitor.csv", "evaluations.csv"])
def test_a_damaged_log_is_put_back_and_that_is_said(name: str, damage: str, run: Path, undisturbed: Path) -> None:
    content = (run / name).read_bytes()
    (run / name).write_bytes(content[:20] if damage == "cut" else b"#" + content)
    if damage == "deleted":
        (run / name).unlink()
    with pytest.warns(UserWarning) as said:
        resume(run, verbose=0)
    assert [str(warning.message) for warning in said] == [f"'{run / name}{PUT_BACK}"]
    assert_same_runs(run, undisturbed)


def test_a_deleted_best_model_is_put_back_and_that_is_said(run: Path, undisturbed: Path) -> None:
    (run / "best_model.zip").unlink()
    with pytest.warns(UserWarning) as said:
        resume(run, verbose=0)
    assert [str(warning.message) for warning in said] == [f"'{run / 'best_model.zip'}{PUT_BACK}"]
    assert_same_runs(run, undisturbed)


def test_deleted_checksums_are_put_back_and_that_is_said(run: Path, undisturbed: Path) -> None:
    (run / "SHA256SUMS").unlink()
    with pytest.warns(UserWarning) as said:
        resume(run, verbose=0)
    expected = f"'{run / 'SHA256SUMS'}' was deleted; it is put back as it was at step 16"
    assert [str(warning.message) for warning in said] == [expected]
    assert_same_runs(run, undisturbed)


def test_a_model_that_a_snapshot_holds_is_made_again_and_of_another_it_is_said(run: Path, undisturbed: Path) -> None:
    for step in (8, 16):
        (run / f"rl_model_{step}_steps.zip").unlink()
    with pytest.warns(UserWarning) as said:
        resume(run, verbose=0)
    missing = f"'{run / 'rl_model_8_steps.zip'}' was deleted or changed, and there is no other copy of it"
    assert [str(warning.message) for warning in said] == [missing]
    name = "rl_model_16_steps.zip"
    assert_same(weights(run, name), weights(undisturbed, name))


def test_an_undamaged_run_is_resumed_without_a_word(run: Path, undisturbed: Path) -> None:
    assert_same_runs(resume_quietly(run).run, undisturbed)


def test_what_was_written_after_the_snapshot_is_taken_back(run: Path, undisturbed: Path) -> None:
    """As by a training on a GPU, which would not come to the same again."""
    better = undisturbed / f"{ENV}.zip"
    shutil.copy(better, run / "best_model.zip")
    with (run / "SHA256SUMS").open("a") as file:
        file.write(f"{sha256(better)}  best_model.zip\n")
    with (run / "evaluations.csv").open("a") as file:
        file.write("20,1.0")
    assert_same_runs(resume_quietly(run).run, undisturbed)


def test_foreign_files_among_the_snapshots_stay(run: Path) -> None:
    (run / "checkpoints" / ".ipynb_checkpoints").mkdir()
    resume_quietly(run)
    assert [path.name for path in (run / "checkpoints").iterdir()] == [".ipynb_checkpoints"]


def test_a_link_in_a_run_is_refused(run: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    (run / "checkpoints").rename(outside)
    (run / "checkpoints").symlink_to(outside)
    before = {path: path.read_bytes() for path in outside.iterdir()}
    with pytest.raises(ConfigError) as error:
        resume(run, verbose=0)
    link = run / "checkpoints"
    assert str(error.value) == f"'{link}' is a link, and a training writes there; put what it points to in its place"
    assert before == {path: path.read_bytes() for path in outside.iterdir()}


def test_a_kill_between_the_end_and_its_cleaning_leaves_no_snapshots(
    run: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(*_: Any) -> None:
        raise Killed

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(session.snapshots, "remove", lambda run, after=-1: die() if after < 0 else None)
        resume(run, verbose=0)
    assert status.has_ended(run, config())
    with pytest.raises(ConfigError, match=r"has ended after 24 steps; there is nothing to resume$"):
        resume(run, verbose=0)
    assert_same_runs(run, undisturbed)


def test_the_model_of_an_interruption_is_not_taken_for_the_final_one(
    run: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C, resumed, killed between the last evaluation and the final model."""
    shutil.copy(run / "rl_model_8_steps.zip", run / f"{ENV}.zip")
    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(session.Session, "_save", lambda *_: (_ for _ in ()).throw(Killed()))
        resume(run, verbose=0)
    assert rows(run / "evaluations.csv")[-1]["timesteps"] == "24"
    assert not status.has_ended(run, config())
    resume(run, verbose=0)
    assert_same_runs(run, undisturbed)


def test_a_status_that_is_none_is_refused(run: Path) -> None:
    file = run / ENV / "status.yml"
    file.write_text("status: perhaps\n")
    with pytest.raises(ConfigError) as error:
        resume(run, verbose=0)
    assert str(error.value) == (
        f"'{file}' must be 'status: training' or 'status: ended'; write the one that is true there"
    )


def test_a_run_without_a_status_is_judged_by_its_files(run: Path, undisturbed: Path, tmp_path: Path) -> None:
    old = Path(shutil.copytree(undisturbed, tmp_path / "old"))
    for path in (old, run):
        (path / ENV / "status.yml").unlink()
    assert status.has_ended(old, config()) and not status.has_ended(run, config())
    scores = (old / "evaluations.csv").read_text()
    (old / "evaluations.csv").write_text(scores[:-9])
    assert not status.has_ended(old, config()), "a torn row is no end"


def test_a_snapshot_of_an_older_version_is_refused(run: Path) -> None:
    snapshots.remove(run)
    (run / "checkpoints").mkdir()
    partial = run / "checkpoints" / "partial"
    th.save({"training": {}, "logs": {}}, partial)
    path = run / "checkpoints" / f"step_16-{sha256(partial)[:16]}.pt"
    partial.rename(path)
    with pytest.raises(ConfigError) as error:
        resume(run, verbose=0)
    assert str(error.value) == (
        f"'{path}' was made by an older version of sb3_stereo; go on with the version that made it (see versions.yml), "
        "or begin with its models: -i best_model.zip"
    )


def events(folder: Path) -> list[tuple[int, float]]:
    accumulators = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    return [(e.step, e.value) for e in accumulators.EventAccumulator(str(folder)).Reload().Scalars("eval/mean_q")]


def test_a_copy_has_tensorboard_files_of_its_own(logs: Path, tmp_path: Path) -> None:
    run = killed(logs, tensorboard_log=str(tmp_path / "tb"))
    copy = Path(shutil.copytree(run, tmp_path / "copy", copy_function=os.link))  # as `cp -al` does
    original = {path: path.read_bytes() for path in [*run.rglob("*"), *(tmp_path / "tb").rglob("*")] if path.is_file()}
    with pytest.warns(UserWarning) as said:
        resume(copy, verbose=0)
    folder = copy / "tensorboard"
    expected = f"'{copy}' was copied or moved; its TensorBoard files from here on are in '{folder}'"
    assert [str(warning.message) for warning in said] == [expected]
    assert [step for step, _ in events(folder)] == [20, 24]
    assert {path: path.read_bytes() for path in original} == original
    resume_quietly(run)
    assert [step for step, _ in events(tmp_path / "tb" / ENV / "DDPG_1")] == [10, 20, 24]
    assert_same(weights(run, f"{ENV}.zip"), weights(copy, f"{ENV}.zip"))


def test_a_clock_that_went_back_does_not_mix_up_tensorboard(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + 5000)
    run = killed(logs, tensorboard_log=str(tmp_path / "tb"))
    monkeypatch.undo()
    monkeypatch.setattr(session, "eval_initial_states", lambda *_: random_initial_states(3, seed=0))
    resume_quietly(run)
    assert [step for step, _ in events(tmp_path / "tb" / ENV / "DDPG_1")] == [10, 20, 24]


@pytest.mark.parametrize("name", ["config.yml", "args.yml", "status.yml", "command.txt"])
def test_a_full_disk_leaves_no_run_without_its_records(
    name: str, logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Path.write_text

    def full(path: Path, *args: Any, **kwargs: Any) -> int:
        if path.name == name:
            raise OSError(28, "No space left on device")
        return write(path, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(ConfigError) as error:
        train(config(), options(logs, tensorboard_log=str(tmp_path / "tb")))
    assert str(error.value) == f"cannot write to '{logs}' (No space left on device); choose a log folder with -f"
    assert not list((logs / "ddpg").iterdir()) and not list((tmp_path / "tb" / ENV).iterdir())


def test_a_refused_training_leaves_no_tensorboard_folder(logs: Path, tmp_path: Path) -> None:
    refused = tiny_config(noise_type=None)
    with pytest.raises(ConfigError):
        train(refused, options(logs, tensorboard_log=str(tmp_path / "tb")))
    assert not list((logs / "ddpg").iterdir()) and not list((tmp_path / "tb" / ENV).iterdir())


def test_files_named_like_runs_are_passed_over(logs: Path) -> None:
    (logs / "ddpg").mkdir(parents=True)
    (logs / "ddpg" / f"{ENV}_1").touch()
    run = creation.create_run(logs, config(), {"algo": "ddpg", "env": ENV})
    assert run.name == f"{ENV}_2" and load_record(run)[0] == config()


def test_the_record_of_a_run_names_the_agent_that_it_began_with_from_everywhere(
    undisturbed: Path, logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(undisturbed)
    run = killed(logs, at=3, trained_agent="best_model.zip")
    monkeypatch.chdir(logs)
    assert resume(run, verbose=0).interrupted is None
    assert yaml.safe_load((run / ENV / "args.yml").read_text())["trained_agent"] == str(undisturbed / "best_model.zip")


def test_an_interruption_before_the_first_step_can_be_gone_on_with(
    logs: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(session, "make_model", interrupted)
        result = train(config(), options(logs))
    assert (result.interrupted, result.n_timesteps, result.model) == ("SIGINT", 0, None)
    run = os.path.relpath(result.run)
    assert train_cli.last_line(result, 1.0) == (
        f"Interrupted by SIGINT after 0 steps in 1 s; resume with: {command_line('train', '--resume', run)}"
    )
    resume(result.run, verbose=0)
    assert_same_runs(result.run, undisturbed)
