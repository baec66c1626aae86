"""Tables for a person at the start and at the end of a training: its settings and its scores."""

from collections.abc import Mapping, Sequence
from typing import Any

from sb3_stereo.config import Config
from sb3_stereo.progress import duration
from sb3_stereo.values import flatten


def settings(config: Config) -> dict[str, Any]:
    """Return a configuration with dotted keys, `policy_kwargs.n_critics`; a wrapper or callback by its class."""
    plain = config.plain()
    components = [item for key in ("env_wrapper", "callback") for item in plain.pop(key)]
    return {"algo": config.algo, **flatten(plain), **dict(map(_component, components))}


def _component(item: str | Mapping[str, Mapping[str, Any]]) -> tuple[str, str]:
    ((path, kwargs),) = item.items() if isinstance(item, Mapping) else [(item, {})]
    return path.rpartition(".")[2], f"({', '.join(f'{name}={value}' for name, value in kwargs.items())})"


def settings_table(config: Config) -> str:
    """Return a line per setting."""
    return aligned([[key, str(value)] for key, value in settings(config).items()], right=False)


def score_table(by_step: Mapping[int, Mapping[str, float]]) -> str:
    """Return a line per score, as `plot.read_scores` reads them."""
    head = ["steps", "reached", "steps when reached", "return", "|a|", "Q", "after"]
    rows = [
        [
            str(step),
            f"{100 * score['success_rate']:.0f} %",
            f"{score['mean_steps_success']:.2f}",
            f"{score['mean_return']:.2f}",
            f"{score['mean_action']:.2f}",
            f"{score['mean_q']:.2f}",
            duration(score["seconds"]),
        ]
        for step, score in by_step.items()
    ]
    return aligned([head, *rows]).replace("nan", "  –")


def aligned(rows: Sequence[Sequence[str]], right: bool = True) -> str:
    """Return rows of cells as lines, each column as wide as its widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    side = ">" if right else "<"
    lines = ("  ".join(f"{cell:{side}{width}}" for cell, width in zip(row, widths)) for row in rows)
    return "\n".join(f"  {line.rstrip()}" for line in lines)
