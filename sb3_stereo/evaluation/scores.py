"""The evaluations of a run: read from its directory, and as a table."""

from collections.abc import Mapping
from pathlib import Path

from sb3_stereo.console import aligned, duration
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import EVALUATIONS, UNREADABLE, scores_by_step


def read_scores(run: Path) -> dict[int, dict[str, float]]:
    """Return a run's scores by step.

    Raises:
        ConfigError: If there are none.
    """
    try:
        scores = scores_by_step(run)
    except FileNotFoundError:
        scores = {}
    except (OSError, *UNREADABLE) as error:
        raise ConfigError(f"cannot read the evaluations in '{run / EVALUATIONS}' ({type(error).__name__})") from error
    if not scores:
        raise ConfigError(f"'{run}' has no evaluations yet; the first comes at the first checkpoint of its training")
    return scores


def score_table(by_step: Mapping[int, Mapping[str, float]]) -> str:
    """Return a line per score, as `plot.read_scores` reads them."""
    head = ["steps", "success", "episode length", "return", "|a|", "Q", "after"]
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
