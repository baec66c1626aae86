"""`early_terminate`: when bad trials are stopped, in environment steps (ASHA) or evaluations (W&B's Hyperband)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass

from sb3_stereo.config.schema import Config
from sb3_stereo.config.validation import STRICT, Integer, Number, checked
from sb3_stereo.errors import ConfigError, unknown
from sb3_stereo.evaluation.callback import eval_steps
from sb3_stereo.tuning.parameters import Parameter

STEPS, SCORES = "timesteps", "n_scores"


@dataclass(frozen=True)
class EarlyTerminate:
    """Asynchronous successive halving: the worse trials are stopped at rungs that lie ever farther apart.

    Attributes:
        unit: What is counted, `STEPS` (of the environment) or `SCORES`.
        first: The first rung.
        last: No rung lies beyond it.
        eta: One in so many trials goes on from a rung; the next is so many times as far.
    """

    unit: str
    first: float
    last: float
    eta: float


@checked_dataclass(frozen=True, config=STRICT)
class Asha:
    """The keys of `type: asha`.

    Attributes:
        min_iter: The first rung, in environment steps.
        eta: See `EarlyTerminate`.
    """

    min_iter: Annotated[Integer, Field(ge=1)]
    eta: Annotated[Number, Field(gt=1)] = 3.0

    def rungs(self, n_timesteps: int, n_scores: int) -> EarlyTerminate:
        """Return when trials of so many steps and scores may be stopped."""
        if self.min_iter >= n_timesteps:
            raise ConfigError(
                f"early_terminate: min_iter must be below n_timesteps ({n_timesteps}), got {self.min_iter}"
            )
        return EarlyTerminate(STEPS, self.min_iter, n_timesteps, self.eta)


@checked_dataclass(frozen=True, config=STRICT)
class Hyperband:
    """The keys of W&B's `type: hyperband`, whose iterations are scores.

    Attributes:
        min_iter: The first rung; the next are `eta` times as far.
        max_iter: Where the rungs end, with `s`: they lie at max_iter / eta, max_iter / eta², ...
        s: How many rungs.
        eta: See `EarlyTerminate`.
    """

    min_iter: Annotated[Integer, Field(ge=1)] | None = None
    max_iter: Annotated[Integer, Field(ge=1)] | None = None
    s: Annotated[Integer, Field(ge=1)] | None = None
    eta: Annotated[Number, Field(gt=1)] = 3.0

    def rungs(self, n_timesteps: int, n_scores: int) -> EarlyTerminate:
        """Return when trials of so many steps and scores may be stopped."""
        first, last = self._ends(n_scores)
        latest = min(n_scores - 1, last)
        if not 1 <= first <= latest:
            raise ConfigError(
                f"early_terminate: hyperband counts scores; its first rung must be from 1 to {latest:g}, before the "
                f"last of a trial's {n_scores}, got {first:g}; change it, or eval_freq"
            )
        return EarlyTerminate(SCORES, first, last, self.eta)

    def _ends(self, n_scores: int) -> tuple[float, float]:
        """Return the first rung and the last, counted in scores."""
        if self.max_iter is None or self.s is None:
            if self.min_iter is None:
                raise ConfigError("early_terminate: hyperband takes min_iter, or max_iter with s; add one of them")
            return self.min_iter, self.max_iter or n_scores
        last = first = self.max_iter / self.eta
        for _ in range(self.s - 1):
            if first / self.eta < (self.min_iter or 1):
                break
            first /= self.eta
        return first, last


TYPES: dict[str, type[Any]] = {"asha": Asha, "hyperband": Hyperband}


def parse_early_terminate(
    given: Mapping[str, Any] | None,
    base: Config,
    parameters: tuple[Parameter, ...],
    eval_freq: int,
    unused: list[str],
) -> EarlyTerminate | None:
    """Read `early_terminate`.

    Args:
        given: Its keys; None stops no trial.
        base: The hyper-parameters that all trials share.
        parameters: What is searched.
        eval_freq: When trials are scored.
        unused: Gets the keys that have no meaning here.
    """
    if given is None:
        return None
    if "type" not in given:
        raise ConfigError("early_terminate lacks 'type'; add it")
    kind = given["type"]
    if str(kind) not in TYPES:
        raise unknown("early_terminate type", kind, TYPES)
    without_effect = {"strict"} | ({"s"} if "max_iter" not in given else set())
    unused += [f"early_terminate.{key}" for key in given if kind == "hyperband" and key in without_effect]
    keys = {key: value for key, value in given.items() if key != "type" and f"early_terminate.{key}" not in unused}
    parsed = checked(TYPES[kind], keys, "early_terminate")
    if any(parameter.name == "n_timesteps" for parameter in parameters):
        raise ConfigError("early_terminate compares trials of equal length; leave it out, or n_timesteps")
    n_scores = len(eval_steps(base.algo, base.n_timesteps, eval_freq)) + 1
    if n_scores == 1:
        raise ConfigError(
            f"early_terminate needs scores during the training; eval_freq: {eval_freq} scores at the end only"
        )
    rungs: EarlyTerminate = parsed.rungs(base.n_timesteps, n_scores)
    return rungs
