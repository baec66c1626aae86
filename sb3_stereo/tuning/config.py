"""A sweep's YAML becomes one checked, frozen description; the keys are those of W&B sweeps where W&B has them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from sb3_stereo.config.components import check_kwargs, parameters
from sb3_stereo.config.schema import DEFAULT_ENV, Config, load_config, overridden
from sb3_stereo.config.values import read_yaml
from sb3_stereo.errors import ConfigError, unknown
from sb3_stereo.evaluation.protocol import Evaluation
from sb3_stereo.tuning.parameters import Parameter, parse_parameters

METHODS = ("bayes", "grid", "random")
GOALS = ("maximize", "minimize")
SCORE_PREFIX = "eval/"
METRICS = tuple(SCORE_PREFIX + score.name for score in fields(Evaluation) if score.type is float)


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


@dataclass(frozen=True)
class EarlyTerminate:
    """Asynchronous successive halving (ASHA): the worse trials are stopped at rungs that lie ever farther apart.

    Attributes:
        type: "asha".
        min_iter: Environment steps before a trial may be stopped, the first rung.
        eta: One in so many trials goes on from a rung; the next is so many times as far.
    """

    type: str
    min_iter: int
    eta: float = 3


@dataclass(frozen=True)
class Resources:
    """What a trial occupies; Ray runs as many trials at a time as fit.

    Attributes:
        cpu: Cores.
        gpu: GPUs; a fraction lets trials share one.
    """

    cpu: float = 1
    gpu: float = 0


@dataclass(frozen=True)
class Sweep:
    """A sweep: every setting is trained with every seed.

    Attributes:
        method: "grid" trains all combinations, "random" draws settings, "bayes" lets Optuna choose them.
        metric: What is looked for; over several seeds its mean.
        parameters: What is searched.
        base: The hyper-parameters that all trials share.
        seeds: Seeds of every setting.
        n_trials: Settings that random and bayes train; 0 for grid.
        eval_freq: When trials are scored, as in train.py.
        early_terminate: Stops bad trials; None trains all to the end.
        resources: What a trial occupies.
        retries: How often a trial that fails is tried again.
    """

    method: str
    metric: Metric
    parameters: tuple[Parameter, ...]
    base: Config
    seeds: tuple[int, ...]
    n_trials: int
    eval_freq: int
    early_terminate: EarlyTerminate | None
    resources: Resources
    retries: int

    def plain(self) -> dict[str, Any]:
        """Return the description as numbers, texts, lists and maps only."""
        base = {"algo": self.base.algo, "env": self.base.env_id, "hyperparams": self.base.plain()}
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "base"}
        nested = {key: asdict(value) for key, value in values.items() if hasattr(value, "__dataclass_fields__")}
        return base | values | nested | {"parameters": [asdict(parameter) for parameter in self.parameters]}


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
        raise ConfigError(f"'{file}' must hold a map with the keys {', '.join(parameters(make_sweep))}")
    kwargs = check_kwargs(make_sweep, content, f"'{source.name}'", {"folder"})
    for key in ("method", "metric", "parameters"):
        if key not in kwargs:
            raise ConfigError(f"'{source.name}' lacks '{key}'; add it")
    return make_sweep(**kwargs, folder=source.parent)


def make_sweep(
    *,
    method: str,
    metric: Mapping[str, Any],
    parameters: Mapping[str, Any],
    algo: str = "ddpg",
    env: str = DEFAULT_ENV,
    conf_file: str | None = None,
    n_timesteps: int = -1,
    seeds: Sequence[int] = (0,),
    n_trials: int = 0,
    eval_freq: int = 0,
    early_terminate: Mapping[str, Any] | None = None,
    resources: Mapping[str, Any] | None = None,
    retries: int = 2,
    folder: Path,
) -> Sweep:
    """Make a sweep of a YAML's keys, which are these arguments.

    Args:
        method: One of `METHODS`.
        metric: See `Metric`.
        parameters: Name to W&B's `value`, `values`, or `min`, `max`, `q` with `distribution`, or nested `parameters`.
        algo: The algorithm.
        env: The environment's id.
        conf_file: Hyper-parameters to start from, relative to the sweep's file; by default ours for the algorithm.
        n_timesteps: Environment steps per trial; by default the hyper-parameters'.
        seeds: See `Sweep`; as are the others.
        folder: Where the sweep's file is.
    """
    searched = parse_parameters(parameters)
    constants = {p.name: p.values[0] for p in searched if p.distribution == "constant"}
    conf = folder / conf_file if conf_file else None
    if conf is not None and not conf.is_file():
        raise ConfigError(f"no conf_file '{conf}'; its path is relative to the sweep's file")
    early = None
    if early_terminate is not None:
        early = EarlyTerminate(**_section(EarlyTerminate, early_terminate, "early_terminate"))
    sweep = Sweep(
        method=method,
        metric=Metric(**_section(Metric, metric, "metric")),
        parameters=tuple(p for p in searched if p.distribution != "constant"),
        base=load_config(algo, env, conf, constants, n_timesteps=n_timesteps),
        seeds=tuple(seeds),
        n_trials=n_trials,
        eval_freq=eval_freq,
        early_terminate=early,
        resources=Resources(**_section(Resources, resources or {}, "resources")),
        retries=retries,
    )
    _check(sweep)
    return sweep


def _section(cls: type, values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Check a map against the fields of a class, and that none is missing."""
    kwargs = check_kwargs(cls, values, name)
    for key, parameter in parameters(cls).items():
        if parameter.default is parameter.empty and key not in kwargs:
            raise ConfigError(f"{name} lacks '{key}'; add it")
    return kwargs


def _check(sweep: Sweep) -> None:
    """Raise a ConfigError for values that are not among the choices or do not go together."""
    if sweep.method not in METHODS:
        raise unknown("method", sweep.method, METHODS)
    if sweep.metric.name not in METRICS:
        raise unknown("metric", sweep.metric.name, METRICS)
    if sweep.metric.goal not in GOALS:
        raise unknown("goal", sweep.metric.goal, GOALS)
    _check_numbers(sweep)
    _check_parameters(sweep)
    _check_early_terminate(sweep)


def _check_numbers(sweep: Sweep) -> None:
    seeds = sweep.seeds
    are_seeds = all(isinstance(seed, int) and 0 <= seed < 2**32 for seed in seeds)
    if not seeds or not are_seeds or len(set(seeds)) < len(seeds):
        raise ConfigError(f"seeds must be different integers from 0 to {2**32 - 1}, got {list(seeds)}")
    if (sweep.method == "grid") != (sweep.n_trials == 0) or sweep.n_trials < 0:
        rule = "does not go with grid, which trains all combinations" if sweep.method == "grid" else "must be positive"
        raise ConfigError(f"n_trials {rule}; got {sweep.n_trials}")
    if sweep.resources.cpu <= 0 or sweep.resources.gpu < 0 or sweep.retries < 0:
        raise ConfigError(
            "resources.cpu must be positive, resources.gpu and retries not negative; "
            f"got {sweep.resources.cpu}, {sweep.resources.gpu} and {sweep.retries}"
        )


def _check_parameters(sweep: Sweep) -> None:
    """Let the hyper-parameters' own checks look at every choice and at both ends of every range."""
    if not sweep.parameters:
        raise ConfigError("parameters hold nothing to search; give one of them values, or min and max")
    for parameter in sweep.parameters:
        if sweep.method == "grid" and not parameter.values:
            raise ConfigError(f"parameter '{parameter.name}': grid needs values; random and bayes take min and max")
        for value in parameter.values or (parameter.min, parameter.max):
            overridden(sweep.base, {parameter.name: value})


def _check_early_terminate(sweep: Sweep) -> None:
    early = sweep.early_terminate
    if early is None:
        return
    if early.type != "asha":
        raise unknown("early_terminate type", early.type, ["asha"])
    if not 0 < early.min_iter < sweep.base.n_timesteps or early.eta <= 1:
        raise ConfigError(
            f"early_terminate: min_iter must be between 0 and n_timesteps ({sweep.base.n_timesteps}) and eta above 1, "
            f"got {early.min_iter} and {early.eta}"
        )
    if sweep.eval_freq < 0:
        raise ConfigError("early_terminate needs scores during the training; eval_freq: -1 scores at the end only")
    if sweep.method == "bayes" and len(sweep.seeds) > 1:
        raise ConfigError(
            "early_terminate does not go with bayes over several seeds; give one seed, or train to the end"
        )
