"""What a sweep may search and what it draws: in W&B's forms, the same for every method, checked before the start."""

import math
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import optuna
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_sweep import BASE, load

from sb3_stereo.config.schema import Config, load_config, overridden
from sb3_stereo.envs.specs import quoted
from sb3_stereo.errors import ConfigError
from sb3_stereo.tuning.config import load_sweep
from sb3_stereo.tuning.parameters import Choice, Parameter, Range, check_examples
from sb3_stereo.tuning.settings import listed_settings
from sb3_stereo.tuning.space import distribution
from sb3_stereo.tuning.stopping import SCORES, EarlyTerminate
from sb3_stereo.tuning.wandb import DISTRIBUTIONS, parse_parameters

SEARCHES = ({"method": "random", "n_trials": 3}, {"method": "bayes", "n_trials": 3})
NOT_FINITE = (float("nan"), float("inf"), float("-inf"))
QUANTILES = np.linspace(0, 1, 2001).tolist()


def parse(**entry: Any) -> Parameter:
    ((parameter,),) = [parse_parameters({"x": entry})[1]]
    return parameter


def refusal(tmp_path: Path, **changes: Any) -> str:
    with pytest.raises(ConfigError) as error:
        load(tmp_path, **changes)
    return str(error.value)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"distribution": "uniform", "min": 8, "max": 16}, "uniform draws fractions, and {}; use int_uniform"),
        ({"min": 8.0, "max": 16.5}, "uniform draws fractions, and {}; use int_uniform"),
        (
            {"distribution": "log_uniform_values", "min": 8, "max": 64},
            "log_uniform_values draws fractions, and {}; use q_log_uniform_values with q: 1",
        ),
        (
            {"distribution": "log_uniform", "min": 2, "max": 4},
            "log_uniform draws fractions, and {}; use q_log_uniform with q: 1",
        ),
        ({"distribution": "normal", "mu": 32, "sigma": 4}, "normal draws fractions, and {}; use q_normal with q: 1"),
        (
            {"distribution": "q_uniform", "min": 8, "max": 16, "q": 0.5},
            "q_uniform draws fractions, and {}; use a whole q",
        ),
        (  # both ends are whole, and so is much between
            {"distribution": "q_log_uniform_values", "min": 1, "max": 189, "q": 0.5},
            "q_log_uniform_values draws fractions, and {}; use a whole q",
        ),
    ],
)
@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize(
    ("key", "refused"),
    [
        ("batch_size", "DDPG: batch_size must be an integer"),
        ("callback.WarmUp.replay_ratio", None),  # a number: any range will do
    ],
)
def test_an_integer_takes_no_range_with_fractions_whatever_the_method(
    entry: dict[str, Any], message: str, search: dict[str, Any], key: str, refused: str | None, tmp_path: Path
) -> None:
    parameters = {"gamma": {"min": 0.1, "max": 0.9}, key: entry}
    if refused is None:
        assert len(load(tmp_path, **search, parameters=parameters).parameters) == 2
    else:
        before, after = f"parameter '{key}': {message}".split("{}")
        found = refusal(tmp_path, **search, parameters=parameters)
        assert found.startswith(f"{before}{refused}, got ") and found.endswith(after)


@pytest.mark.parametrize("number", NOT_FINITE)
@pytest.mark.parametrize("key", ["min", "max", "q"])
@pytest.mark.parametrize("search", [*SEARCHES, {}])
def test_a_bound_must_be_a_number(number: float, key: str, search: dict[str, Any], tmp_path: Path) -> None:
    entry = {"distribution": "q_uniform", "min": 0.1, "max": 0.9, "q": 0.1, key: number}
    assert refusal(tmp_path, **search, parameters={"gamma": entry}) == (
        f"parameter 'gamma': {key} must be a finite number, got {number}"
    )


@pytest.mark.parametrize("number", NOT_FINITE)
def test_resources_and_counts_must_be_numbers(number: float, tmp_path: Path) -> None:
    asha = {"type": "asha", "min_iter": 10}
    for changes, message in (
        ({"resources": {"cpu": number}}, "resources: cpu must be a finite number"),
        ({"resources": {"gpu": number}}, "resources: gpu must be a finite number"),
        ({"early_terminate": asha | {"min_iter": number}}, "early_terminate: min_iter must be an integer"),
        ({"early_terminate": asha | {"eta": number}}, "early_terminate: eta must be a finite number"),
        ({"n_trials": number, "method": "random"}, "'tiny.yml': n_trials must be an integer"),
        ({"retries": number}, "'tiny.yml': retries must be an integer"),
        ({"n_timesteps": number}, "'tiny.yml': n_timesteps must be an integer"),
        ({"run_cap": number}, "'tiny.yml': run_cap must be an integer"),
        ({"eval_freq": number}, "'tiny.yml': eval_freq must be an integer"),
    ):
        assert refusal(tmp_path, **changes) == f"{message}, got {number}"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_timesteps": 0}, "'tiny.yml': n_timesteps must be at least 1, got 0"),
        ({"n_timesteps": -5}, "'tiny.yml': n_timesteps must be at least 1, got -5"),
        ({"retries": -1}, "'tiny.yml': retries must be at least 0, got -1"),
        ({"method": "random", "n_trials": 10**9}, "'tiny.yml': n_trials must be at most 10000, got 1000000000"),
        ({"resources": {"gpu": 1.5}}, "resources: gpu must be 0, a fraction from 0.0001 to 1, or whole, got 1.5"),
        ({"resources": {"cpu": 1e-9}}, "resources: cpu must be at least 0.0001, got 1e-09"),
        ({"retries": 10**400}, f"'tiny.yml': retries must be at most 9007199254740992, got {quoted(10**400)}"),
        ({"resources": {"cpu": 10**400}}, f"resources: cpu must be a number, got {quoted(10**400)}"),
        ({"resources": {"cpu": True}}, "resources: cpu must be a number, got True"),
        (
            {"parameters": {"buffer_size": {"min": 1, "max": 10**9}}},
            "1e+09 settings with 2 seeds are more than 10000 trials; give fewer values, or run_cap",
        ),
        (
            {"parameters": {"tau": {"distribution": "q_uniform", "min": 0.11, "max": 0.14, "q": 0.05}}},
            "parameter 'tau': no multiple of q 0.05 lies between 0.11 and 0.14; choose a smaller q",
        ),
        (
            {"parameters": {"tau": {"distribution": "log_uniform", "min": 1, "max": 1000}}},
            "parameter 'tau': the bounds are exponents of e, and e^1000 is no number of a computer; log_uniform_values "
            "takes the bounds themselves",
        ),
        (
            {"parameters": {"gamma": {"values": [0.5, float("nan")]}}},
            "parameter 'gamma': nan is no value; leave it out",
        ),
        (
            {"parameters": {"gamma": {"values": [0.5], "probabilities": [0.5, 0.5]}}, "method": "random"},
            "parameter 'gamma': probabilities must be one per value and not all 0, got [0.5, 0.5] for 1 values",
        ),
        (
            {"parameters": {"gamma": {"values": [0.5, 0.6], "probabilities": [1, 1]}}},
            "parameter 'gamma': grid takes all values; leave the probabilities out",
        ),
        (
            {
                "parameters": {
                    "policy_kwargs.n_critics": {"value": 1},
                    "policy_kwargs": {"parameters": {"n_critics": {}}},
                }
            },
            "parameter 'policy_kwargs.n_critics' is given twice; leave one out",
        ),
        ({"run_cap": 1}, "run_cap 1 is less than one setting with 2 seeds; raise it"),
        (
            {"early_terminate": {"type": "hyperband", "min_iter": 3}},
            "early_terminate: hyperband counts scores; its first rung must be from 1 to 1, before the last of a "
            "trial's 2, got 3; change it, or eval_freq",
        ),
        (
            {"early_terminate": {"type": "asha", "min_iter": 3}, "eval_freq": 30},
            "early_terminate needs scores during the training; eval_freq: 30 scores at the end only",
        ),
        (
            {"early_terminate": {"type": "asha", "min_iter": 3}, "parameters": {"n_timesteps": {"values": [30, 60]}}},
            "early_terminate compares trials of equal length; leave it out, or n_timesteps",
        ),
    ],
)
def test_what_no_sweep_can_do_is_refused_before_it_starts(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    assert refusal(tmp_path, **changes) == message


finite = st.floats(-1e6, 1e6, allow_nan=False).map(lambda x: float(f"{x:.6g}"))
positive = st.floats(1e-6, 1e6).map(lambda x: float(f"{x:.6g}"))
exponent = st.floats(-20, 20)
ENDS = {"int_uniform": st.integers(-(10**6), 10**6), "uniform": finite, "q_uniform": finite}
ENDS |= {name: positive for name in DISTRIBUTIONS if name.endswith("_values")}


@st.composite
def entries(draw: st.DrawFn) -> dict[str, Any]:
    """Any range in W&B's form."""
    name = draw(st.sampled_from([name for name in DISTRIBUTIONS if name not in ("constant", "categorical")][1:]))
    entry: dict[str, Any] = {"distribution": name}
    if name.endswith("normal"):
        entry |= {"mu": draw(st.floats(-5, 5)), "sigma": draw(st.floats(1e-3, 3))}
    else:
        ends = ENDS.get(name, exponent)
        low, high = sorted(draw(st.tuples(ends, ends).filter(lambda pair: pair[0] != pair[1])))
        entry |= {"min": low, "max": high}
    if name.startswith("q_"):
        entry["q"] = draw(st.sampled_from([1, 2, 0.5, 0.1, 0.005, 32]))
    return entry


def draws(parameter: Range, quantiles: list[float], seed: int) -> list[float]:
    """What the methods draw: both ends and any quantile of random's, and bayes' through Optuna's own sampler."""
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
    space = {"x": distribution(parameter)}
    bayes = [parameter.settle(study.ask(space).params["x"]) for _ in range(5)]
    ends = [parameter.settle(parameter.low), parameter.settle(parameter.high)]
    return [*ends, *bayes, *(parameter.draw(u) for u in (0.0, 1.0, *quantiles))]


optuna.logging.set_verbosity(optuna.logging.WARNING)


@settings(deadline=None, max_examples=150)
@given(entries(), st.lists(st.floats(0, 1), max_size=5), st.integers(0, 2**31))
def test_every_draw_lies_on_a_step_between_the_bounds(entry: dict[str, Any], quantiles: list[float], seed: int) -> None:
    try:
        parameter = parse(**entry)
    except ConfigError as error:
        assert "no multiple of q" in str(error) or "min must be below max" in str(error)
        return
    assert isinstance(parameter, Range)
    slack = 1e-9 * max(abs(parameter.low), abs(parameter.high), parameter.step)
    for value in draws(parameter, quantiles, seed):
        assert parameter.low - slack <= value <= parameter.high + slack
        assert parameter.settle(value) == value  # a continued search names the same setting
        if parameter.step:
            assert value == pytest.approx(round(value / parameter.step) * parameter.step, rel=1e-9, abs=1e-12)
            assert isinstance(value, int) == float(parameter.step).is_integer()


BASE_CONFIG = load_config("ddpg", BASE["env"], n_timesteps=30)  # type: ignore[arg-type]


def config(setting: dict[str, Any]) -> Config:
    return overridden(BASE_CONFIG, setting)


@settings(deadline=None, max_examples=60)
@given(
    entries(), st.sampled_from(["batch_size", "gamma"]), st.lists(st.floats(0, 1), max_size=3), st.integers(0, 2**31)
)
def test_what_a_sweep_accepts_can_be_trained_whatever_is_drawn(
    entry: dict[str, Any], key: str, quantiles: list[float], seed: int
) -> None:
    try:
        (parameter,) = parse_parameters({key: entry})[1]
        check_examples((parameter,), config)
    except ConfigError:
        return
    assert isinstance(parameter, Range)
    for value in draws(parameter, quantiles, seed):
        config({key: value})


def test_distributions_are_those_that_wandb_documents() -> None:
    def drawn(**entry: Any) -> list[Any]:
        parameter = parse(**entry)
        return [parameter.draw(u) for u in QUANTILES]

    third = len(QUANTILES) // 2
    # log_uniform's bounds are exponents of e; log_uniform_values' are the values; inv_log_uniform's are those of 1/x.
    for entry in (
        {"distribution": "log_uniform", "min": math.log(1e-4), "max": math.log(1e-2)},
        {"distribution": "log_uniform_values", "min": 1e-4, "max": 1e-2},
        {"distribution": "inv_log_uniform", "min": math.log(1e2), "max": math.log(1e4)},
        {"distribution": "inv_log_uniform_values", "min": 1e-4, "max": 1e-2},
    ):
        values = drawn(**entry)
        assert [values[0], values[third], values[-1]] == pytest.approx([1e-4, 1e-3, 1e-2])
    # round(x / q) * q: 0.0 would be below min, so it counts as 0.005.
    values = drawn(distribution="q_uniform", min=0.001, max=0.02, q=0.005)
    assert sorted(set(values)) == [0.005, 0.01, 0.015, 0.02]
    assert Counter(drawn(distribution="q_uniform", min=0.5, max=3.5)).keys() == {1, 2, 3}  # q is 1 by default
    assert set(drawn(distribution="q_log_uniform_values", min=300, max=3000, q=32)) == set(range(320, 2977, 32))
    counts = Counter(drawn(min=1, max=4))
    assert counts.keys() == {1, 2, 3, 4} and max(counts.values()) - min(counts.values()) <= 2
    values = drawn(distribution="normal", mu=100, sigma=10)
    assert np.mean(values) == pytest.approx(100) and np.std(values) == pytest.approx(10, rel=0.02)
    assert np.mean(np.abs(np.array(values) - 100) < 10) == pytest.approx(0.6827, abs=0.002)
    assert np.median(drawn(distribution="log_normal", mu=math.log(0.01), sigma=0.5)) == pytest.approx(0.01)
    values = drawn(distribution="q_normal", mu=32, sigma=4, q=8)
    assert set(values) == {16, 24, 32, 40, 48} and all(isinstance(value, int) for value in values)
    counts = Counter(drawn(values=["a", "b", "c"], probabilities=[0.1, 0.3, 0.6]))
    assert [round(counts[letter] / len(QUANTILES), 2) for letter in "abc"] == [0.1, 0.3, 0.6]
    assert set(drawn(values=[1, 2], probabilities=[0, 3])) == {2}
    assert parse_parameters({"x": {"distribution": "constant", "value": 2.5}}) == ({"x": 2.5}, ())
    assert parse(values=[1, None]) == Choice("x", (1, None))


def test_a_grid_is_every_combination_also_of_steps(tmp_path: Path) -> None:
    parameters = {"gamma": {"values": [0.5, 0.9]}, "batch_size": {"min": 4, "max": 6}}
    parameters["tau"] = {"distribution": "q_uniform", "min": 0.1, "max": 0.3, "q": 0.1}  # type: ignore[dict-item]
    found = [tuple(setting.values()) for setting in load(tmp_path, parameters=parameters).settings()]
    assert found == [(batch, gamma, tau) for batch in (4, 5, 6) for gamma in (0.5, 0.9) for tau in (0.1, 0.2, 0.3)]


def test_random_draws_the_same_settings_again_also_when_the_sweep_grows(tmp_path: Path) -> None:
    few, many = (
        load(tmp_path, method="random", n_trials=n, parameters={"gamma": {"min": 0.5, "max": 0.9}}) for n in (2, 5)
    )
    assert len(many.settings()) == 5 and many.settings()[:2] == few.settings()


def test_no_setting_is_drawn_twice_and_what_runs_out_ends_the_search(tmp_path: Path) -> None:
    values = {"gamma": {"values": [0.5, 0.9]}, "batch_size": {"min": 4, "max": 5}}
    found = load(tmp_path, method="random", n_trials=50, parameters=values)
    assert found.n_settings == 4 and len({str(setting) for setting in found.settings()}) == 4
    rare = Choice("x", (1, 2, 3), (1.0, 1.0, 1e-12))
    assert [setting["x"] for setting in listed_settings([rare], "random", 3)] in ([1, 2], [2, 1])


def test_hyper_parameters_that_need_each_other_are_searched_together(tmp_path: Path) -> None:
    noise = {"noise_type": {"values": ["normal"]}, "noise_std": {"values": [0.1, 0.3]}}
    base = {"algo": "td3", "conf_file": "td3.yml"}
    (tmp_path / "td3.yml").write_text("default: {n_timesteps: 30, policy: MlpPolicy}\n")
    assert len(load(tmp_path, **base, parameters=noise).settings()) == 2


def test_keys_of_wandb_that_mean_nothing_here_are_named_and_run_cap_counts_trials(tmp_path: Path) -> None:
    keys = {"program": "train.py", "command": ["${env}", "${program}"], "project": "reach", "entity": "us"}
    keys |= {"name": "first", "description": "a study", "run_cap": 5}
    metric = {"name": "eval/mean_return", "goal": "maximize", "target": 1.0}
    values = {"gamma": {"values": [0.1, 0.5, 0.9]}}
    found = load(tmp_path, **keys, metric=metric, parameters=values)
    assert set(found.unused) == {"program", "command", "project", "entity", "name", "description", "metric.target"}
    assert found.n_settings == len(found.settings()) == 2  # with two seeds each
    drawn = load(
        tmp_path,
        method="bayes",
        run_cap=9,
        parameters={"gamma": {"values": [0.1, 0.2, 0.3, 0.4, 0.5], "probabilities": [1] * 5}},
    )
    assert drawn.n_settings == 4 and drawn.unused == ("probabilities of 'gamma' (for random)",)


def test_hyperband_counts_scores_as_wandb_does(tmp_path: Path) -> None:
    def rungs(**keys: Any) -> EarlyTerminate | None:
        return load(
            tmp_path, n_timesteps=60, eval_freq=2, early_terminate={"type": "hyperband", **keys}
        ).early_terminate

    assert rungs(min_iter=3) == EarlyTerminate(SCORES, 3, 30, 3.0)
    assert rungs(max_iter=27, s=2) == EarlyTerminate(SCORES, 3, 9, 3.0)
    assert rungs(min_iter=5, s=2) == EarlyTerminate(SCORES, 5, 30, 3.0)  # as W&B, which needs max_iter for it
    assert rungs(min_iter=3, max_iter=12) == EarlyTerminate(SCORES, 3, 12, 3.0)
    assert rungs(min_iter=2, max_iter=27, s=5) == EarlyTerminate(SCORES, 3, 9, 3.0)
    assert rungs(max_iter=27, s=9, eta=2, strict=True) == EarlyTerminate(SCORES, 27 / 16, 27 / 2, 2.0)


JUNK: list[Any] = [
    None,
    True,
    0,
    -1,
    1.5,
    float("nan"),
    10**400,
    "",
    "x",
    [],
    [[1]],
    {},
    {"type": 1},
    {1: 2},
    {None: 1},
]
PLACES = [
    (key,) for key in (*BASE, "algo", "conf_file", "n_trials", "run_cap", "early_terminate", "resources", 1, None)
]
METRIC: Any = BASE["metric"]
PLACES += [("metric", key) for key in ("name", "goal", "target", 1)]
PLACES += [("resources", key) for key in ("cpu", "gpu", None)]
PLACES += [("early_terminate", key) for key in ("type", "min_iter", "max_iter", "s", "eta", "strict", 1)]
PLACES += [("parameters", key) for key in ("", ".", "gamma", "gamma.x", "callback", "policy_kwargs.", None, 1)]
KEYS = ("value", "values", "min", "max", "q", "mu", "sigma", "probabilities", "distribution", "parameters", 1, None)
PLACES += [("parameters", "gamma", key) for key in KEYS]


@settings(deadline=None, max_examples=150)
@given(st.sampled_from(PLACES), st.sampled_from(JUNK), st.sampled_from(["grid", "random", "bayes"]))
def test_whatever_stands_in_a_file_is_a_sweep_or_one_sentence(place: tuple[Any, ...], junk: Any, method: str) -> None:
    content: dict[Any, Any] = {**BASE, "metric": {**METRIC}, "method": method, "run_cap": 4, "seeds": [3]}
    content["early_terminate"] = {"type": "hyperband", "min_iter": 1}
    content["parameters"] = {"gamma": {"distribution": "q_uniform", "min": 0.1, "max": 0.9, "q": 0.1}}
    inner = content
    for key in place[:-1]:
        inner = inner.setdefault(key, {})
    inner[place[-1]] = junk
    with TemporaryDirectory() as folder:
        file = Path(folder) / "tiny.yml"
        file.write_text(yaml.safe_dump(content))
        try:
            load_sweep(file).plain()
        except ConfigError as error:
            assert str(error) and "\n" not in str(error)
