"""Sweeps without Ray's processes: the YAML, the search spaces, the trials' records and the report."""

import shutil
import sys
from pathlib import Path
from typing import Any

import fake_reach
import pytest
import yaml
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from ray.tune.search.repeater import TRIAL_INDEX
from ray.tune.search.variant_generator import generate_variants

from sb3_stereo import evaluate, sweep
from sb3_stereo.config import load_config, overridden
from sb3_stereo.errors import ConfigError
from sb3_stereo.tuning import trials
from sb3_stereo.tuning.config import Parameter, Sweep, load_sweep
from sb3_stereo.tuning.records import STOPPED, claim, find_trial, is_done, read_trials, settings
from sb3_stereo.tuning.report import BEST, PICTURE, TABLE, write_report
from sb3_stereo.tuning.search import Job, optuna_search, tuner_arguments
from sb3_stereo.tuning.space import distribution, domain, optuna_space, tune_space
from sb3_stereo.tuning.trials import run_trial

SHIPPED = Path(__file__).parent.parent / "hyperparams" / "sweeps"
BASE = {
    "env": fake_reach.ENV_ID,
    "n_timesteps": 30,
    "eval_freq": 15,
    "seeds": [3, 5],
    "method": "grid",
    "metric": {"name": "eval/mean_steps_capped", "goal": "minimize"},
    "parameters": {"gamma": {"values": [0.5, 0.9]}},
}
# So small that a trial takes less than a second.
CHEAP = {"n_timesteps": 30, "policy": "MlpPolicy", "policy_kwargs": {"net_arch": [8]}}
CHEAP |= {"learning_starts": 10, "batch_size": 4, "buffer_size": 50}
RANGES = {"gamma": {"min": 0.5, "max": 0.9}}


def write(tmp_path: Path, **changes: Any) -> Path:
    """Write the tiny sweep with changes; None leaves a key out."""
    content = {key: value for key, value in (BASE | changes).items() if value is not None}
    file = tmp_path / "tiny.yml"
    file.write_text(yaml.safe_dump(content))
    return file


def load(tmp_path: Path, **changes: Any) -> Sweep:
    return load_sweep(write(tmp_path, **changes))


def load_cheap(tmp_path: Path, **changes: Any) -> Sweep:
    (tmp_path / "cheap.yml").write_text(yaml.safe_dump({"default": CHEAP}))
    return load(tmp_path, conf_file="cheap.yml", **changes)


def test_the_shipped_sweeps_are_valid() -> None:
    found = {file.stem: load_sweep(file) for file in SHIPPED.glob("*.yml")}
    assert found.keys() == {"ddpg_gamma", "ddpg_search", "dqn_levels"}
    assert found["ddpg_gamma"].base == load_config("ddpg", "WamStereoReach-v0", SHIPPED.parent / "paper" / "ddpg.yml")
    assert found["ddpg_gamma"].parameters == (Parameter("gamma", "categorical", (0.5, 0.9, 0.99)),)
    (levels,) = found["dqn_levels"].parameters
    for n in levels.values:
        config = overridden(found["dqn_levels"].base, {levels.name: n})
        assert config.env_wrapper[0].kwargs == {"levels": n}


def test_constants_join_the_hyperparameters_and_the_rest_is_searched(tmp_path: Path) -> None:
    found = load(tmp_path, parameters=BASE["parameters"] | {"batch_size": {"value": 4}})  # type: ignore[operator]
    assert found.base.algo_kwargs["batch_size"] == 4
    assert found.base.n_timesteps == 30
    assert [parameter.name for parameter in found.parameters] == ["gamma"]
    assert found.seeds == (3, 5)


def test_nested_parameters_and_dotted_keys_are_the_same(tmp_path: Path) -> None:
    inner = {"values": [1, 2]}
    nested = {"policy_kwargs": {"parameters": {"n_critics": inner}}}
    assert load(tmp_path, parameters=nested) == load(tmp_path, parameters={"policy_kwargs.n_critics": inner})


def test_a_range_without_distribution_is_of_integers_if_its_ends_are(tmp_path: Path) -> None:
    parameters = {"batch_size": {"min": 2, "max": 4}, "gamma": {"min": 0, "max": 0.5}, "tau": {"min": 1e-3, "max": 1}}
    parameters["tau"]["distribution"] = "log_uniform_values"  # type: ignore[assignment]
    found = load(tmp_path, method="random", n_trials=2, parameters=parameters).parameters
    assert [p.distribution for p in found] == ["int_uniform", "uniform", "log_uniform_values"]


def test_scientific_numbers_are_numbers(tmp_path: Path) -> None:
    file = tmp_path / "s.yml"
    file.write_text(write(tmp_path).read_text().replace("- 0.5", "- 5e-1"))
    assert load_sweep(file) == load(tmp_path)


ERRORS: list[tuple[dict[str, Any], str]] = [
    (
        {"metod": "grid"},
        "unknown argument of 'tiny.yml' 'metod' (did you mean 'method'?); allowed are: algo, conf_file, "
        "early_terminate, env, eval_freq, method, metric, n_timesteps, n_trials, parameters, resources, retries, seeds",
    ),
    ({"method": None}, "'tiny.yml' lacks 'method'; add it"),
    ({"method": "hyperband"}, "unknown method 'hyperband'; allowed are: bayes, grid, random"),
    ({"metric": "eval/success_rate"}, "'tiny.yml': metric must be a map, got 'eval/success_rate'"),
    ({"metric": {"name": "eval/success_rate"}}, "metric lacks 'goal'; add it"),
    (
        {"metric": {"name": "success_rate", "goal": "maximize"}},
        "unknown metric 'success_rate' (did you mean 'eval/success_rate'?); allowed are: eval/mean_action, "
        "eval/mean_pixel_distance, eval/mean_q, eval/mean_return, eval/mean_steps_capped, eval/mean_steps_success, "
        "eval/success_rate",
    ),
    (
        {"metric": {"name": "eval/mean_q", "goal": "max"}},
        "unknown goal 'max'; allowed are: maximize, minimize",
    ),
    ({"algo": "her"}, "unknown algorithm 'her'; allowed are: crossq, ddpg, dqn, ppo, sac, td3, tqc"),
    ({"seeds": 3}, "'tiny.yml': seeds must be a list, got 3"),
    ({"seeds": [1, 1]}, "seeds must be different integers from 0 to 4294967295, got [1, 1]"),
    ({"n_trials": 5}, "n_trials does not go with grid, which trains all combinations; got 5"),
    ({"method": "random", "parameters": RANGES}, "n_trials must be positive; got 0"),
    (
        {"resources": {"gpus": 1}},
        "unknown argument of resources 'gpus' (did you mean 'gpu'?); allowed are: cpu, gpu",
    ),
    (
        {"resources": {"cpu": 0}},
        "resources.cpu must be positive, resources.gpu and retries not negative; got 0, 0 and 2",
    ),
    ({"parameters": {}}, "parameters hold nothing to search; give one of them values, or min and max"),
    ({"parameters": {"gamma": 0.5}}, "parameter 'gamma' must be a map, as in gamma: {values: [...]}; got 0.5"),
    ({"parameters": RANGES}, "parameter 'gamma': grid needs values; random and bayes take min and max"),
    (
        {"parameters": {"gamma": {"values": [0.5, 0.5]}}},
        "parameter 'gamma': values must be a list without repetitions, got [0.5, 0.5]",
    ),
    ({"parameters": {"gamma": {"min": 0.5}}}, "parameter 'gamma': uniform takes min, max, got min"),
    (
        {"parameters": {"gamma": {"min": 0.5, "max": 0.9, "distribution": "normal"}}},
        "unknown distribution of 'gamma' 'normal' (did you mean 'uniform'?); allowed are: categorical, constant, "
        "int_uniform, log_uniform_values, q_uniform, uniform",
    ),
    ({"parameters": {"gamma": {"min": 0.9, "max": 0.5}}}, "parameter 'gamma': min must be below max, got 0.9 and 0.5"),
    ({"parameters": {"gamma": {"min": "low", "max": 1}}}, "parameter 'gamma': min must be a number, got 'low'"),
    (
        {"parameters": {"tau": {"min": 0, "max": 1, "distribution": "log_uniform_values"}}},
        "parameter 'tau': log_uniform_values needs a positive min, got 0",
    ),
    ({"parameters": {"gamma": {"values": ["high"]}}}, "DDPG: gamma must be a number, got 'high'"),
    (
        {"parameters": {"callback.WarmUp": {"values": [1]}}},
        "unknown class or argument in 'callback.WarmUp' 'WarmUp'; allowed are: AnnealExploration.<argument>, "
        "LearnFromMotion.<argument>, StereoReplay.<argument>, WarmUp.<argument>",
    ),
    ({"early_terminate": {"type": "asha"}}, "early_terminate lacks 'min_iter'; add it"),
    (
        {"early_terminate": {"type": "hyperband", "min_iter": 10}},
        "unknown early_terminate type 'hyperband'; allowed are: asha",
    ),
    (
        {"early_terminate": {"type": "asha", "min_iter": 30}},
        "early_terminate: min_iter must be between 0 and n_timesteps (30) and eta above 1, got 30 and 3",
    ),
    (
        {"early_terminate": {"type": "asha", "min_iter": 10}, "eval_freq": -1},
        "early_terminate needs scores during the training; eval_freq: -1 scores at the end only",
    ),
    (
        {
            "early_terminate": {"type": "asha", "min_iter": 10},
            "method": "bayes",
            "n_trials": 2,
        },
        "early_terminate does not go with bayes over several seeds; give one seed, or train to the end",
    ),
]


@pytest.mark.parametrize(("changes", "message"), ERRORS)
def test_wrong_keys_and_values_are_named(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        load(tmp_path, **changes)
    assert str(error.value) == message


def test_wrong_flags_are_one_sentence_and_status_2(
    tmp_path: Path, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path)
    expected = {
        ("no.yml",): "no sweep 'no.yml'; give a YAML file such as hyperparams/sweeps/ddpg_gamma.yml",
        (str(file), "--workers", "-1"): "--workers must not be negative, got -1",
        (str(file), "--device", "cuda"): "--device cuda needs a GPU per trial; add it, as in resources: {gpu: 0.25}",
    }
    for arguments, message in expected.items():
        assert sweep.main([*arguments, "-f", str(logs)]) == 2
        assert capsys.readouterr().err == f"error: {message}\n"
    assert not logs.exists()


def test_a_cluster_that_is_not_there_is_named_at_once(
    tmp_path: Path, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sweep.main([str(write(tmp_path)), "-f", str(logs), "--address", "127.0.0.1:1"]) == 2
    assert capsys.readouterr().err == (
        "error: no Ray cluster at '127.0.0.1:1' ([Errno 111] Connection refused); start one with: ray start --head\n"
    )


def test_a_missing_conf_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        load(tmp_path, conf_file="no.yml")
    assert str(error.value) == f"no conf_file '{tmp_path / 'no.yml'}'; its path is relative to the sweep's file"


@pytest.mark.filterwarnings("ignore:Choices for a categorical distribution")
def test_domains_draw_what_the_distributions_promise() -> None:
    parameters = {
        "choice": Parameter("a", "categorical", ([1, 2], "b")),
        "integer": Parameter("a", "int_uniform", min=1, max=3),
        "step": Parameter("a", "q_uniform", min=4, max=12, q=4),
        "log": Parameter("a", "log_uniform_values", min=1e-4, max=1e-2),
        "real": Parameter("a", "uniform", min=0.5, max=0.9),
    }
    drawn = {name: [domain(parameter).sample() for _ in range(200)] for name, parameter in parameters.items()}
    assert {str(value) for value in drawn["choice"]} == {"[1, 2]", "b"}
    assert set(drawn["integer"]) == {1, 2, 3}
    assert set(drawn["step"]) == {4, 8, 12}
    assert min(drawn["log"]) >= 1e-4 and max(drawn["log"]) <= 1e-2 and 50 < sum(v < 1e-3 for v in drawn["log"]) < 150
    assert min(drawn["real"]) >= 0.5 and max(drawn["real"]) <= 0.9
    assert [distribution(parameter) for parameter in parameters.values()] == [
        CategoricalDistribution(([1, 2], "b")),
        IntDistribution(1, 3),
        FloatDistribution(4, 12, step=4),
        FloatDistribution(1e-4, 1e-2, log=True),
        FloatDistribution(0.5, 0.9),
    ]


def test_a_grid_is_every_combination_with_every_seed(tmp_path: Path) -> None:
    parameters = BASE["parameters"] | {"tau": {"values": [0.1, 0.2, 0.3]}}  # type: ignore[operator]
    space = tune_space(load(tmp_path, parameters=parameters))
    found = [spec["config"] for _, spec in generate_variants({"config": space})]
    assert {(c["gamma"], c["tau"], c[TRIAL_INDEX]) for c in found} == {
        (gamma, tau, index) for gamma in (0.5, 0.9) for tau in (0.1, 0.2, 0.3) for index in (0, 1)
    }
    assert len(found) == 12


def test_random_draws_the_same_settings_again_also_when_the_sweep_grows(tmp_path: Path) -> None:
    def drawn(n_trials: int, seeds: list[int]) -> list[tuple[float, int]]:
        found = load(tmp_path, method="random", n_trials=n_trials, seeds=seeds, parameters=RANGES)
        arguments, space = tuner_arguments(found, tmp_path, 0)
        search = arguments["search_alg"]
        return [
            (spec["config"]["gamma"], spec["config"][TRIAL_INDEX])
            for _ in range(arguments["num_samples"])
            for _, spec in generate_variants(
                {"config": space}, constant_grid_search=search._constant_grid_search, random_state=search._random_state
            )
        ]

    few, many = drawn(2, [3]), drawn(3, [3, 5])
    assert len(few) == 2 and len(many) == 6
    assert [gamma for gamma, _ in many[::2]] == [gamma for gamma, _ in many[1::2]]
    assert few == many[:4:2]


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
    job = Job(found, folder, "cpu", gym_packages=("fake_reach",), command=("python", "-m", "sb3_stereo.sweep", "x.yml"))
    for _, spec in generate_variants({"config": tune_space(found)}):
        run_trial(spec["config"], job.training)


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
    assert (run / "FakeReach-v0" / "command.txt").read_text() == "python -m sb3_stereo.sweep x.yml\n"
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
        (run / "FakeReach-v0.zip").unlink()
    (second / STOPPED).write_text("")
    assert [trial.state for trial in read_trials(found, logs)] == ["unfinished", "stopped"]
    run_grid(found, logs)
    assert {t.params["gamma"]: t.state for t in read_trials(found, logs)} == {0.5: "finished", 0.9: "stopped"}
    assert len(list((logs / "ddpg").iterdir())) == 2


def test_a_run_that_was_killed_while_it_was_made_is_nobodys(tmp_path: Path, logs: Path) -> None:
    found = load_cheap(tmp_path)
    (logs / "ddpg" / "FakeReach-v0_1" / "FakeReach-v0").mkdir(parents=True)
    assert find_trial(logs, found.base, 3) is None and read_trials(found, logs) == []


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
    assert tuner_arguments(found, logs, 0)[0]["num_samples"] == 3 * 2


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
        f"'{logs}' holds another sweep (see sweep.yml), of which only n_trials, resources, retries, seeds may change; "
        "choose another log folder with -f, or another file name"
    )
