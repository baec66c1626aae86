"""A sweep's YAML as one validated, frozen description; the keys are W&B's where W&B has them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass

from sb3_stereo.config.schema import DEFAULT_ENV, Config, load_config, overridden
from sb3_stereo.config.validation import STRICT, Integer, Number, checked
from sb3_stereo.config.values import read_yaml
from sb3_stereo.errors import ConfigError, unknown
from sb3_stereo.evaluation.protocol import Evaluation
from sb3_stereo.tuning.parameters import Choice, Parameter, check_examples, n_settings
from sb3_stereo.tuning.settings import listed_settings
from sb3_stereo.tuning.stopping import EarlyTerminate, parse_early_terminate
from sb3_stereo.tuning.wandb import parse_parameters

METHODS = ("bayes", "grid", "random")
GOALS = ("maximize", "minimize")
SCORE_PREFIX = "eval/"
METRICS = tuple(SCORE_PREFIX + score.name for score in fields(Evaluation) if score.type is float)
# Keys of W&B's files that name a script, an account or a service, of which there is none here.
WITHOUT_MEANING = frozenset(
    {"$schema", "apiVersion", "command", "controller", "description", "entity", "image_uri", "job", "kind"}
    | {"launch", "name", "program", "project"}
)
MAX_TRIALS = 10_000  # they take minutes each; more are a mistake in a range
N_CHECKED = 500  # settings that are checked one by one before a sweep starts


@dataclass(frozen=True)
class Metric:
    """What a sweep looks for.

    Attributes:
        name: A score's name in TensorBoard, one of `METRICS`; the one at the end of the training counts.
        goal: "maximize" or "minimize".
    """

    name: str
    goal: str

    @property
    def score(self) -> str:
        """The column of `evaluations.csv`."""
        return self.name.removeprefix(SCORE_PREFIX)

    @property
    def worst(self) -> float:
        """What an undefined score counts as."""
        return float("-inf") if self.goal == "maximize" else float("inf")


@checked_dataclass(frozen=True, config=STRICT)
class Resources:
    """What a trial occupies; Ray runs as many trials at a time as fit.

    Attributes:
        cpu: Cores.
        gpu: GPUs; a fraction lets trials share one.
    """

    cpu: Annotated[Number, Field(ge=1e-4)] = 1.0  # Ray counts in ten-thousandths
    gpu: Annotated[Number, Field(ge=0)] = 0.0

    def __post_init__(self) -> None:
        if 0 < self.gpu < 1e-4 or (self.gpu > 1 and not self.gpu.is_integer()):
            raise ConfigError(f"resources: gpu must be 0, a fraction from 0.0001 to 1, or whole, got {self.gpu:g}")


@dataclass(frozen=True)
class Sweep:
    """A sweep: every setting is trained with every seed.

    Attributes:
        method: "grid" trains all combinations, "random" draws settings, "bayes" lets Optuna choose them.
        metric: What is looked for; over several seeds its mean.
        parameters: What is searched.
        base: The hyper-parameters that all trials share.
        seeds: Seeds of every setting.
        n_settings: How many settings are trained.
        eval_freq: When trials are scored, as in train.py.
        early_terminate: Stops bad trials; None trains all to the end.
        resources: What a trial occupies.
        retries: How often a trial that fails is tried again.
        unused: Keys of the file that have no meaning here.
    """

    method: str
    metric: Metric
    parameters: tuple[Parameter, ...]
    base: Config
    seeds: tuple[int, ...]
    n_settings: int
    eval_freq: int
    early_terminate: EarlyTerminate | None
    resources: Resources
    retries: int
    unused: tuple[str, ...] = ()

    def settings(self) -> list[dict[str, Any]]:
        """Return the settings of grid and random, which are known beforehand."""
        return listed_settings(self.parameters, self.method, self.n_settings)

    def setting(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Return the setting that a sampler's draws stand for."""
        return {parameter.name: parameter.settle(drawn[parameter.name]) for parameter in self.parameters}

    def plain(self) -> dict[str, Any]:
        """Return the description as numbers, texts, lists and maps only."""
        early = asdict(self.early_terminate) if self.early_terminate else None
        return {
            "algo": self.base.algo,
            "env": self.base.env_id,
            "hyperparams": self.base.plain(),
            "method": self.method,
            "metric": asdict(self.metric),
            "parameters": [asdict(parameter) for parameter in self.parameters],
            "seeds": list(self.seeds),
            "n_trials": self.n_settings,
            "eval_freq": self.eval_freq,
            "early_terminate": early,
            "resources": {"cpu": self.resources.cpu, "gpu": self.resources.gpu},
            "retries": self.retries,
        }


@checked_dataclass(frozen=True, config=STRICT)
class SweepFile:
    """The keys of a sweep's YAML.

    Attributes:
        method: One of `METHODS`.
        metric: See `Metric`.
        parameters: Name to W&B's `value`, `values`, or a `distribution` with its arguments, or nested `parameters`.
        algo: The algorithm.
        env: The environment's id.
        conf_file: Hyper-parameters to start from, relative to the sweep's file; by default ours for the algorithm.
        n_timesteps: Environment steps per trial; by default the hyper-parameters'.
        seeds: See `Sweep`; as are the others.
        n_trials: Settings that random and bayes train.
        run_cap: At most so many trials, that is settings times seeds.
    """

    method: str
    metric: dict[str, Any]
    parameters: dict[Any, Any]
    algo: str = "ddpg"
    env: str = DEFAULT_ENV
    conf_file: str | None = None
    n_timesteps: Annotated[Integer, Field(ge=1)] | None = None
    seeds: list[Any] | None = None
    n_trials: Annotated[Integer, Field(ge=1, le=MAX_TRIALS)] | None = None
    run_cap: Annotated[Integer, Field(ge=1)] | None = None
    eval_freq: Integer = 0
    early_terminate: dict[str, Any] | None = None
    resources: dict[str, Any] | None = None
    retries: Annotated[Integer, Field(ge=0)] = 2


def load_sweep(file: str | Path) -> Sweep:
    """Read and check a sweep's YAML.

    Raises:
        ConfigError: If anything in it is unknown, missing, of the wrong type or does not go together.
    """
    source = Path(file)
    if not source.is_file():
        raise ConfigError(f"no sweep '{file}'; give a YAML file such as hyperparams/sweeps/ddpg_gamma.yml")
    content = read_yaml(source)
    if not isinstance(content, Mapping):
        keys = ", ".join(field.name for field in fields(SweepFile))
        raise ConfigError(f"'{file}' must hold a map with the keys {keys}")
    unused = [key for key in content if key in WITHOUT_MEANING]
    used = {key: value for key, value in content.items() if key not in unused}
    return make_sweep(checked(SweepFile, used, f"'{source.name}'"), source.parent, unused)


def make_sweep(keys: SweepFile, folder: Path, unused: list[str]) -> Sweep:
    """Make a sweep of a YAML's keys.

    Args:
        keys: The keys.
        folder: Where the sweep's file is.
        unused: Keys of the file that have no meaning here.
    """
    if keys.method not in METHODS:
        raise unknown("method", keys.method, METHODS)
    seeds = _seeds(keys.seeds)
    constants, searched = parse_parameters(keys.parameters)
    conf = folder / keys.conf_file if keys.conf_file else None
    if conf is not None and not conf.is_file():
        raise ConfigError(f"no conf_file '{conf}'; its path is relative to the sweep's file")
    base = load_config(keys.algo, keys.env, conf, constants, n_timesteps=keys.n_timesteps or -1)
    _check_parameters(keys.method, searched)
    check_examples(searched, lambda params: overridden(base, params))
    early = parse_early_terminate(keys.early_terminate, base, searched, keys.eval_freq, unused)
    if early and keys.method == "bayes" and len(seeds) > 1:
        raise ConfigError(
            "early_terminate does not go with bayes over several seeds; give one seed, or train to the end"
        )
    if keys.method == "bayes":
        unused += [f"probabilities of '{p.name}' (for random)" for p in searched if isinstance(p, Choice) and p.weights]
    sweep = Sweep(
        method=keys.method,
        metric=_metric(keys.metric, unused),
        parameters=searched,
        base=base,
        seeds=seeds,
        n_settings=_n_settings(keys, searched, len(seeds)),
        eval_freq=keys.eval_freq,
        early_terminate=early,
        resources=checked(Resources, keys.resources or {}, "resources"),
        retries=keys.retries,
        unused=tuple(unused),
    )
    for setting in islice(sweep.settings(), N_CHECKED):  # what goes alone may not go together
        overridden(base, setting)
    return sweep


def _seeds(given: list[Any] | None) -> tuple[int, ...]:
    seeds = tuple([0] if given is None else given)
    are_seeds = all(isinstance(seed, int) and not isinstance(seed, bool) and 0 <= seed < 2**32 for seed in seeds)
    if not seeds or not are_seeds or len(set(seeds)) < len(seeds):
        raise ConfigError(f"seeds must be different integers from 0 to {2**32 - 1}, got {list(seeds)}")
    return seeds


def _metric(given: Mapping[str, Any], unused: list[str]) -> Metric:
    """Read W&B's `metric`; a `target` ends no sweep here, and a trial that fails is repeated, not imputed."""
    ignored = [key for key in given if key in ("target", "impute", "impute_while_running")]
    unused += [f"metric.{key}" for key in ignored]
    keys = {key: value for key, value in given.items() if key not in ignored}
    for key in keys:
        if key not in ("name", "goal"):
            raise unknown("argument of metric", key, ("name", "goal"))
    for key in ("name", "goal"):  # W&B's default, minimize, would be wrong for most of our scores
        if key not in keys:
            raise ConfigError(f"metric lacks '{key}'; add it")
    if keys["name"] not in METRICS:
        raise unknown("metric", keys["name"], METRICS)
    if keys["goal"] not in GOALS:
        raise unknown("goal", keys["goal"], GOALS)
    return Metric(keys["name"], keys["goal"])


def _check_parameters(method: str, parameters: tuple[Parameter, ...]) -> None:
    """Raise a ConfigError if there is nothing to search, or not by this method."""
    if not parameters:
        raise ConfigError("parameters hold nothing to search; give one of them values, or min and max")
    for parameter in parameters if method == "grid" else ():
        if parameter.n_values == float("inf"):
            raise ConfigError(
                f"parameter '{parameter.name}': grid needs values, or a range with steps (int_uniform, q_uniform); "
                "random and bayes take any range"
            )
        if isinstance(parameter, Choice) and parameter.weights:
            raise ConfigError(f"parameter '{parameter.name}': grid takes all values; leave the probabilities out")


def _n_settings(keys: SweepFile, parameters: tuple[Parameter, ...], n_seeds: int) -> int:
    """Return how many settings are trained."""
    possible = n_settings(parameters)
    if keys.method == "grid" and keys.n_trials is not None:
        raise ConfigError(f"n_trials does not go with grid, which trains all combinations; got {keys.n_trials}")
    cap = keys.run_cap // n_seeds if keys.run_cap else None
    if cap == 0:
        raise ConfigError(f"run_cap {keys.run_cap} is less than one setting with {n_seeds} seeds; raise it")
    wanted = possible if keys.method == "grid" else keys.n_trials or cap
    if wanted is None:
        raise ConfigError(f"{keys.method} needs n_trials, how many settings to train; add it")
    n = min(wanted, possible, cap or possible)
    if n * n_seeds > MAX_TRIALS:
        raise ConfigError(
            f"{n:g} settings with {n_seeds} seed{'s' * (n_seeds > 1)} are more than {MAX_TRIALS} trials; "
            "give fewer values, or run_cap"
        )
    return int(n)
