"""Sweeps without Ray's processes: the trials, their records and the report."""

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_reach
import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from tiny_sweep import BASE, RANGES, load_cheap

from sb3_stereo.commands import evaluate
from sb3_stereo.config.schema import load_config, overridden
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs import status
from sb3_stereo.tuning import trials
from sb3_stereo.tuning.config import Sweep
from sb3_stereo.tuning.records import STOPPED, Trial, claim, find_trial, is_done, read_trials, settings
from sb3_stereo.tuning.report import BEST, PICTURE, TABLE, write_report
from sb3_stereo.tuning.search import Job, bayes_arguments, optuna_search
from sb3_stereo.tuning.space import optuna_space
from sb3_stereo.tuning.study import JOURNAL
from sb3_stereo.tuning.trials import Training, Watch, run_trial


@pytest.fixture
def reports(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """What trials report when they run in this process."""
    found: list[tuple[str, int]] = []
    monkeypatch.setattr(
        trials.tune, "report", lambda scores: found.append((Path(scores["run"]).name, scores["timesteps"]))
    )
    monkeypatch.setattr(sys, "orig_argv", list(sys.orig_argv))
    return found


def run_grid(found: Sweep, folder: Path) -> None:
    job = Job(
        found,
        folder,
        "cpu",
        gym_packages=("fake_reach",),
        command=("python", "-m", "sb3_stereo", "sweep", "x.yml"),
    )
    for training in job.listed():
        run_trial({}, lambda _, training=training: training)


def test_a_trial_is_an_ordinary_run_and_is_trained_once(
    tmp_path: Path, logs: Path, reports: list[tuple[str, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    found = load_cheap(tmp_path)
    claim(found, logs)
    run_grid(found, logs)
    assert sorted(set(reports)) == [(f"FakeReach-v0_{n}", step) for n in (1, 2, 3, 4) for step in (15, 30)]
    assert len(reports) == 8
    runs = {trial.run: (trial.run / "evaluations.csv").stat().st_mtime_ns for trial in read_trials(found, logs)}
    assert len(runs) == 4 and is_done(found, logs)
    run = logs / "ddpg" / "FakeReach-v0_2"
    assert (run / "FakeReach-v0" / "command.txt").read_text() == "python -m sb3_stereo sweep x.yml\n"
    assert evaluate.main([str(run), "--poses", "2", "--num-threads", "1", "--n-envs", "1"]) == 0
    run_grid(found, logs)  # everything is there: only reported
    assert reports[8:] == reports[:8]
    assert runs == {trial.run: (trial.run / "evaluations.csv").stat().st_mtime_ns for trial in read_trials(found, logs)}


def test_an_interrupted_trial_goes_on_in_its_run_and_a_stopped_one_stays(
    tmp_path: Path, logs: Path, reports: list[tuple[str, int]]
) -> None:
    found = load_cheap(tmp_path, seeds=[3])
    claim(found, logs)
    run_grid(found, logs)
    first, second = (trial.run for trial in read_trials(found, logs))
    for run in (first, second):
        status.mark(run, status.NEW)
    (second / STOPPED).write_text("")
    assert [trial.state for trial in read_trials(found, logs)] == ["unfinished", "stopped"]
    run_grid(found, logs)
    assert {t.params["gamma"]: t.state for t in read_trials(found, logs)} == {0.5: "finished", 0.9: "stopped"}
    assert len(list((logs / "ddpg").iterdir())) == 2


def test_a_run_that_was_killed_while_it_was_made_is_nobodys(tmp_path: Path, logs: Path) -> None:
    found = load_cheap(tmp_path)
    (logs / "ddpg" / "FakeReach-v0_1" / "FakeReach-v0").mkdir(parents=True)
    assert find_trial(logs, found.base, 3) is None and read_trials(found, logs) == []


def outcomes(trials: list[Trial]) -> dict[str, tuple[str, int, float]]:
    return {str(trial.params): (trial.state, trial.timesteps, trial.score) for trial in trials}


@pytest.mark.parametrize("says_ended", [False, True])
def test_a_row_that_was_cut_off_is_no_end_of_a_trial_which_goes_on(
    says_ended: bool,
    tmp_path: Path,
    logs: Path,
    reports: list[tuple[str, int]],
) -> None:
    found = load_cheap(tmp_path, seeds=[3], parameters={"gamma": {"values": [0.5]}})
    run_grid(found, logs)
    (whole,) = read_trials(found, logs)
    text = (whole.run / "evaluations.csv").read_bytes()
    start = text.rstrip().rindex(b"\n") + 1
    for end in (*range(start + 1, len(text) - 2, 9), len(text) - 3):
        (whole.run / "evaluations.csv").write_bytes(text[:end])
        (torn,) = read_trials(found, logs)
        assert (torn.state, torn.timesteps) == ("unfinished", 15) and abs(torn.score) != float("inf")
        assert not is_done(found, logs)
    if not says_ended:  # as before version 0.1.0; the status of a run counts less than its scores
        (whole.run / "FakeReach-v0" / "status.yml").unlink()
    run_grid(found, logs)
    assert outcomes(read_trials(found, logs)) == outcomes([whole]) and is_done(found, logs)
    assert (logs / "ddpg" / "FakeReach-v0_1.damaged_1" / "evaluations.csv").is_file() == says_ended


@pytest.mark.parametrize("content", ["", "\0", "timesteps\nten\n", "a,b\n1,2\n", "timesteps,mean_steps_capped\n15,\n"])
def test_scores_that_are_damaged_are_those_of_no_finished_trial(
    content: str, tmp_path: Path, logs: Path, reports: list[tuple[str, int]]
) -> None:
    found = load_cheap(tmp_path, seeds=[3])
    run_grid(found, logs)
    (read_trials(found, logs)[1].run / "evaluations.csv").write_text(content)
    assert [trial.state for trial in read_trials(found, logs)] == ["finished", "unfinished"]
    assert "unfinished" in write_report(found, logs)


def test_a_run_that_is_no_trial_is_named_and_left_out(
    tmp_path: Path, logs: Path, reports: list[tuple[str, int]]
) -> None:
    found = load_cheap(tmp_path, seeds=[3])
    run_grid(found, logs)
    ours = read_trials(found, logs)
    strangers = {
        2: ("args.yml", lambda text: text.replace("params:", "other:"), "not a trial of this sweep"),
        3: ("args.yml", lambda text: text.replace("gamma: 0.5", "tau: 0.5"), "not a trial of this sweep"),
        4: ("args.yml", lambda text: text.replace("seed: 3", "seed: three"), "not a trial of this sweep"),
        5: ("config.yml", lambda text: text.replace("n_timesteps: 30", "n_timesteps: 40"), "a trial of another sweep"),
        6: ("args.yml", lambda text: "", "is not the record of a training (TypeError)"),
        7: ("config.yml", lambda text: "", "is not the record of a training (TypeError)"),
        8: ("config.yml", lambda text: "\udcff", "is not the record of a training (UnicodeDecodeError)"),
        9: ("args.yml", lambda text: text.replace("env: FakeReach-v0", "env: [1]"), "a training (TypeError)"),
    }
    for number, (name, damage, _) in strangers.items():
        run = logs / "ddpg" / f"FakeReach-v0_{number + 1}"
        shutil.copytree(ours[0].run, run)
        file = run / "FakeReach-v0" / name
        assert damage(file.read_text()) != file.read_text()
        file.write_text(damage(file.read_text()), errors="surrogateescape")
    assert read_trials(found, logs) == ours and is_done(found, logs)
    lines = [line for line in write_report(found, logs).splitlines() if line.startswith("Left out: ")]
    assert len(lines) == len(strangers)
    for line, (number, (_, _, reason)) in zip(lines, strangers.items(), strict=True):
        assert line.startswith(f"Left out: FakeReach-v0_{number + 1}: ") and line.endswith(reason)


@pytest.mark.parametrize("content", ["", "- 1", "3", "# nothing"])
def test_a_folder_that_does_not_say_which_sweep_it_holds_is_refused(content: str, tmp_path: Path, logs: Path) -> None:
    claim(load_cheap(tmp_path), logs)
    (logs / "sweep.yml").write_text(content)
    with pytest.raises(ConfigError) as error:
        claim(load_cheap(tmp_path), logs)
    assert str(error.value) == (
        f"'{logs / 'sweep.yml'}' does not say which sweep the folder holds: it is empty or damaged; delete that file "
        "if the runs beside it are this sweep's, or choose another log folder with -f"
    )
    assert (logs / "sweep.yml").read_text() == content


def test_a_trial_whose_values_do_not_go_together_fails_alone() -> None:
    def refuses(config: dict[str, Any]) -> Training:
        raise ConfigError("these do not go together")

    watch = Watch(refuses, lambda training, result: "", verbose=0)
    trial: Any = SimpleNamespace(config={"gamma": 0.5, "tau": 1}, error_file=None, num_failures=1)
    watch.on_trial_recover(0, [], trial)
    watch.on_trial_error(0, [], trial)
    assert watch.failures == ["gamma 0.5, tau 1: the process died (all of it: .)"]


def test_optuna_begins_with_the_setting_whose_step_lies_at_its_bounds(
    tmp_path: Path, logs: Path, reports: list[tuple[str, int]]
) -> None:
    values = {"gamma": {"values": [0.3]}}
    run_grid(load_cheap(tmp_path, seeds=[3], parameters=values), logs)
    steps = {"gamma": {"distribution": "q_uniform", "min": 0.1, "max": 0.30000000000000004, "q": 0.1}}
    steps["gamma"]["min"] = 0.1 + 0.2 - 0.2
    found = load_cheap(tmp_path, seeds=[3], method="bayes", n_trials=2, parameters=steps)
    known = settings(found, read_trials(found, logs))
    assert [(setting.params, setting.is_closed) for setting in known] == [({"gamma": 0.3}, True)]
    (done,) = optuna_search(found, known)._ot_study.get_trials()
    assert done.value == known[0].score


def test_optuna_knows_what_is_trained_and_begins_with_what_is_not_quite(
    tmp_path: Path, logs: Path, reports: list[tuple[str, int]]
) -> None:
    run_grid(load_cheap(tmp_path), logs)
    found = load_cheap(tmp_path, method="bayes", n_trials=4, parameters=BASE["parameters"] | RANGES)  # type: ignore[operator]
    shutil.rmtree(logs / "ddpg" / "FakeReach-v0_4")
    known = settings(found, read_trials(found, logs))
    assert [(setting.params["gamma"], setting.is_closed) for setting in known] == [(0.5, True), (0.9, False)]
    study = optuna_search(found, known)._ot_study
    (done,) = study.get_trials(states=[1])  # COMPLETE
    assert (done.params, done.value) == ({"gamma": 0.5}, known[0].score)
    assert study.ask(optuna_space(found)).params == {"gamma": 0.9}
    assert bayes_arguments(found, logs)["num_samples"] == 3 * 2


def test_the_report_ranks_settings_by_their_mean_over_seeds(
    tmp_path: Path, logs: Path, reports: list[tuple[str, int]]
) -> None:
    found = load_cheap(tmp_path)
    assert write_report(found, logs) == "No trial has begun yet."
    run_grid(found, logs)
    rows = {(0.5, 3): 4.0, (0.5, 5): 3.0, (0.9, 3): 2.0, (0.9, 5): 4.0}
    for trial in read_trials(found, logs):
        lines = (trial.run / "evaluations.csv").read_text().splitlines()
        values = dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))
        values["mean_steps_capped"] = str(rows[trial.params["gamma"], trial.seed])
        (trial.run / "evaluations.csv").write_text(f"{lines[0]}\n{','.join(values.values())}\n")
    text = write_report(found, logs).splitlines()
    assert [line.split() for line in text[:3]] == [
        ["gamma", "eval/mean_steps_capped", "seeds", "steps", "state", "runs"],
        ["0.9", "3", "2", "of", "2", "30", "finished", "3,4"],
        ["0.5", "3.5", "2", "of", "2", "30", "finished", "1,2"],
    ]
    assert (logs / TABLE).read_text().splitlines()[1] == "FakeReach-v0_1,3,finished,30,4.0,0.5"
    assert (logs / PICTURE).stat().st_size > 1000
    journal = JournalStorage(JournalFileBackend(str(logs / JOURNAL)))
    done = optuna.load_study(study_name=None, storage=journal).trials
    assert [(trial.params, trial.value) for trial in done] == [({"gamma": "0.5"}, 3.5), ({"gamma": "0.9"}, 3.0)]
    assert done[1].user_attrs["scores"] == [2.0, 4.0]
    assert write_report(found, logs).splitlines() == text  # written anew, not twice
    comment = (logs / BEST).read_text().splitlines()[0]
    assert comment == "# The best of 2 settings: eval/mean_steps_capped 3, the mean over 2 seeds."
    assert load_config("ddpg", fake_reach.ENV_ID, logs / BEST) == overridden(found.base, {"gamma": 0.9})


def test_an_undefined_score_is_the_worst(tmp_path: Path, logs: Path, reports: list[tuple[str, int]]) -> None:
    found = load_cheap(tmp_path, seeds=[3])
    run_grid(found, logs)
    run = logs / "ddpg" / "FakeReach-v0_1"
    text = (run / "evaluations.csv").read_text()
    columns, *_, last = (line.split(",") for line in text.splitlines())
    last[columns.index("mean_steps_capped")] = "nan"
    (run / "evaluations.csv").write_text(f"{','.join(columns)}\n{','.join(last)}\n")
    assert [setting.score for setting in settings(found, read_trials(found, logs))][-1] == float("inf")


def test_a_folder_belongs_to_one_sweep_which_may_only_grow(tmp_path: Path, logs: Path) -> None:
    claim(load_cheap(tmp_path), logs)
    claim(load_cheap(tmp_path, seeds=[3, 5, 7], retries=0), logs)
    with pytest.raises(ConfigError) as error:
        claim(load_cheap(tmp_path, n_timesteps=40), logs)
    assert str(error.value) == (
        f"'{logs}' holds another sweep (see sweep.yml), of which only n_trials, resources, retries, run_cap, seeds "
        "may change; choose another log folder with -f, or another file name"
    )
