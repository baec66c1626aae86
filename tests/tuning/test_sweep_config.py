"""A sweep's YAML, and the search spaces that it becomes."""

from pathlib import Path
from typing import Any

import pytest
from tiny_sweep import BASE, RANGES, load, write

from sb3_stereo.commands import sweep
from sb3_stereo.config.schema import load_config, overridden
from sb3_stereo.errors import ConfigError
from sb3_stereo.tuning.config import load_sweep
from sb3_stereo.tuning.parameters import Choice

SHIPPED = Path(__file__).parents[2] / "hyperparams" / "sweeps"


def test_the_shipped_sweeps_are_valid() -> None:
    found = {file.stem: load_sweep(file) for file in SHIPPED.glob("*.yml")}
    assert found.keys() == {"ddpg_gamma", "ddpg_search", "dqn_levels"}
    assert found["ddpg_gamma"].base == load_config("ddpg", "WamStereoReach-v0", SHIPPED.parent / "paper" / "ddpg.yml")
    assert found["ddpg_gamma"].parameters == (Choice("gamma", (0.5, 0.9, 0.99)),)
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
        "early_terminate, env, eval_freq, method, metric, n_timesteps, n_trials, parameters, resources, retries, "
        "run_cap, seeds",
    ),
    ({"method": None}, "'tiny.yml' lacks 'method'; add it"),
    ({"method": "hyperband"}, "unknown method 'hyperband'; allowed are: bayes, grid, random"),
    ({"metric": "eval/success_rate"}, "'tiny.yml': metric must be a map, got 'eval/success_rate'"),
    ({"metric": {"name": "eval/success_rate"}}, "metric lacks 'goal'; add it"),
    (
        {"metric": {"name": "success_rate", "goal": "maximize"}},
        "unknown metric 'success_rate' (did you mean 'eval/success_rate'?); allowed are: eval/mean_action, "
        "eval/mean_pixel_distance, eval/mean_q, eval/mean_return, eval/mean_steps_capped, eval/mean_steps_success, "
        "eval/median_distance_success, eval/p95_distance_success, eval/success_rate, eval/within_5cm",
    ),
    (
        {"metric": {"name": "eval/mean_q", "goal": "max"}},
        "unknown goal 'max'; allowed are: maximize, minimize",
    ),
    ({"algo": "her"}, "unknown algorithm 'her'; allowed are: crossq, ddpg, dqn, ppo, sac, td3, tqc"),
    ({"seeds": 3}, "'tiny.yml': seeds must be a list, got 3"),
    ({"seeds": [1, 1]}, "seeds must be different integers from 0 to 4294967295, got [1, 1]"),
    ({"n_trials": 5}, "n_trials does not go with grid, which trains all combinations; got 5"),
    ({"method": "random", "parameters": RANGES}, "random needs n_trials, how many settings to train; add it"),
    (
        {"resources": {"gpus": 1}},
        "unknown argument of resources 'gpus' (did you mean 'gpu'?); allowed are: cpu, gpu",
    ),
    (
        {"resources": {"cpu": 0}},
        "resources: cpu must be at least 0.0001, got 0",
    ),
    ({"parameters": {}}, "parameters hold nothing to search; give one of them values, or min and max"),
    ({"parameters": {"gamma": 0.5}}, "parameter 'gamma' must be a map, as in gamma: {values: [...]}; got 0.5"),
    (
        {"parameters": RANGES},
        "parameter 'gamma': grid needs values, or a range with steps (int_uniform, q_uniform); random and bayes take "
        "any range",
    ),
    (
        {"parameters": {"gamma": {"values": [0.5, 0.5]}}},
        "parameter 'gamma': values must be a list without repetitions, got [0.5, 0.5]",
    ),
    ({"parameters": {"gamma": {"min": 0.5}}}, "parameter 'gamma' lacks 'max'; add it"),
    (
        {"parameters": {"gamma": {"min": 0.5, "max": 0.9, "distribution": "uni"}}},
        "unknown distribution of 'gamma' 'uni' (did you mean 'uniform'?); allowed are: categorical, "
        "categorical_w_probabilities, constant, int_uniform, inv_log_uniform, inv_log_uniform_values, log_normal, "
        "log_uniform, log_uniform_values, normal, "
        "q_log_normal, q_log_uniform, q_log_uniform_values, q_normal, q_uniform, uniform",
    ),
    ({"parameters": {"gamma": {"min": 0.9, "max": 0.5}}}, "parameter 'gamma': min must be below max, got 0.9 and 0.5"),
    ({"parameters": {"gamma": {"min": "low", "max": 1}}}, "parameter 'gamma': min must be a number, got 'low'"),
    (
        {"parameters": {"tau": {"min": 0, "max": 1, "distribution": "log_uniform_values"}}},
        "parameter 'tau': log_uniform_values needs a positive min, got 0",
    ),
    ({"parameters": {"gamma": {"values": ["high"]}}}, "DDPG: gamma must be a number, got 'high'"),
    (
        {"parameters": {"dynamics_step": {"values": [1]}}},
        "unknown hyper-parameter of ddpg 'dynamics_step' (did you mean 'dynamics_steps'?); allowed are: "
        "augmentation, batch_size, buffer_size, callback, dynamics_steps, env_kwargs, env_wrapper, "
        "eval_env_kwargs, exploration, "
        "frame_stack, gamma, "
        "gradient_steps, learning_rate, learning_starts, monitor_kwargs, n_envs, n_steps, n_timesteps, noise_std, "
        "noise_type, optimize_memory_usage, policy, policy_kwargs, pretraining, replay_buffer_class, "
        "replay_buffer_kwargs, tau, train_freq",
    ),
    ({"early_terminate": {"type": "asha"}}, "early_terminate lacks 'min_iter'; add it"),
    (
        {"early_terminate": {"type": "envelope", "min_iter": 10}},
        "unknown early_terminate type 'envelope'; allowed are: asha, hyperband",
    ),
    (
        {"early_terminate": {"type": "asha", "min_iter": 30}},
        "early_terminate: min_iter must be below n_timesteps (30), got 30",
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
