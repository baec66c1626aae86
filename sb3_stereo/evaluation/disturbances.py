"""The disturbance suite: how an agent does in worlds that differ from the one it was trained in.

A world is described by the environment's own `randomize`; whatever randomisation a run was trained with is replaced.
Every kind of change has up to three grades, from mild to hard, and everything else stays as it is.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sb3_stereo.building.factory import VEC_ENVS, make_env
from sb3_stereo.config.schema import Config, check_env_kwargs
from sb3_stereo.console import aligned
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.curves import save_figure
from sb3_stereo.evaluation.protocol import Evaluation, InitialState, evaluate

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

GRADES = ("mild", "middle", "hard")
CLEAN = "none"  # of the row without a disturbance


@dataclass(frozen=True)
class Disturbance:
    """One kind of change.

    Attributes:
        kind: Its name.
        family: Light, sensor, cameras, arm, look or clutter.
        unit: Of the sizes, empty for factors and shares.
        sizes: Of each grade, from mild to hard; with fewer than three, the hardest ones.
        settings: From a size to the environment's arguments.
    """

    kind: str
    family: str
    unit: str
    sizes: tuple[float, ...]
    settings: Callable[[float], dict[str, Any]]

    @property
    def grades(self) -> tuple[str, ...]:
        """Of the sizes."""
        return GRADES[len(GRADES) - len(self.sizes) :]


def _of(name: str, **others: Any) -> Callable[[float], dict[str, Any]]:
    return lambda size: {"randomize": {name: size, **others}}


def _degrees(name: str) -> Callable[[float], dict[str, Any]]:
    return lambda size: {"randomize": {name: math.radians(size)}}


DISTURBANCES = (
    Disturbance("less ambient light", "light", "", (0.6, 0.4, 0.2), _of("ambient")),
    Disturbance("light from elsewhere", "light", "rad", (0.5, 1.0, 2.0), _of("light_angle", ambient=0.5)),
    Disturbance("shadow on a floor", "light", "darkness", (0.2, 0.4, 0.7), _of("shadow", floor=1.0)),
    Disturbance("darker", "light", "exposure", (0.9, 0.7, 0.5), _of("exposure")),
    Disturbance("brighter", "light", "exposure", (1.1, 1.3, 1.6), _of("exposure")),
    Disturbance("colour cast", "light", "", (0.1, 0.2, 0.4), _of("colour_cast")),
    Disturbance("noise", "sensor", "of 255", (5.0, 15.0, 40.0), _of("noise")),
    Disturbance("blur", "sensor", "px", (1.0, 2.0, 4.0), _of("blur")),
    Disturbance("JPEG", "sensor", "loss", (50.0, 80.0, 95.0), _of("compression")),
    Disturbance("shift", "sensor", "px", (4.0, 8.0, 12.0), _of("shift")),
    Disturbance("dead pixels", "sensor", "", (0.001, 0.01, 0.05), _of("dead_pixels")),
    Disturbance("patches before the lens", "sensor", "", (1.0, 2.0, 4.0), _of("patches")),
    Disturbance("cameras moved", "cameras", "m", (0.025, 0.05, 0.1), _of("camera_position")),
    Disturbance("cameras turned", "cameras", "deg", (0.25, 0.5, 1.0), _degrees("camera_rotation")),
    Disturbance("wider field of view", "cameras", "", (1.02, 1.05, 1.1), _of("field_of_view")),
    Disturbance("narrower field of view", "cameras", "", (0.98, 0.95, 0.9), _of("field_of_view")),
    Disturbance("weaker", "arm", "effort", (0.9, 0.8, 0.6), _of("effort")),
    Disturbance("stronger", "arm", "effort", (1.1, 1.2, 1.4), _of("effort")),
    Disturbance("more damping", "arm", "", (1.3, 2.0, 3.0), _of("damping")),
    Disturbance("dry friction", "arm", "N m", (0.25, 0.5, 1.0), _of("friction")),
    Disturbance("heavier", "arm", "mass", (1.1, 1.3, 1.6), _of("mass")),
    Disturbance("gravity error", "arm", "of the weight", (0.1, 0.3, 1.0), _of("gravity")),
    Disturbance("latency", "arm", "s", (0.05, 0.1, 0.2), _of("latency")),
    Disturbance("no brake", "arm", "", (1.0,), lambda size: {"randomize": {}, "brake": False}),
    Disturbance("link colours", "look", "", (0.25, 0.5, 1.0), _of("link_colours")),
    Disturbance("floor, then with a pattern", "look", "", (0.0, 1.0), _of("floor_pattern", floor=1.0)),
    Disturbance("picture behind", "look", "of cameras", (0.25, 0.5, 1.0), _of("background")),
    Disturbance("clutter", "clutter", "things", (2.0, 5.0, 10.0), _of("clutter")),
)


@dataclass(frozen=True)
class Score:
    """Of one agent in one world.

    Attributes:
        kind: Of the disturbance, or `CLEAN`.
        family: Of the kind.
        grade: One of `GRADES`; empty without a disturbance.
        size: Of the change.
        unit: Of the size.
        success_rate: 0 to 1.
        mean_steps_capped: Failures counted as the episode's cap.
        within_5cm: Share of the starts that ended within 5 cm in space and as a success; NaN if it is not told.
        n_poses: Starts.
    """

    kind: str
    family: str
    grade: str
    size: float
    unit: str
    success_rate: float
    mean_steps_capped: float
    within_5cm: float
    n_poses: int


def camera_losses(config: Config) -> tuple[Disturbance, ...]:
    """For each camera of an environment with the argument `lost_camera`, that it is lost: its picture is black."""
    try:
        check_env_kwargs(config.env_id, {**config.env_kwargs, "lost_camera": None})
    except ConfigError:
        return ()
    env: Any = make_env(config.env_id, config.env_kwargs, ())()
    names = dict.fromkeys(camera.spec.name for camera in env.unwrapped.cameras)
    env.close()
    return tuple(Disturbance(f"camera {name} lost", "cameras", "", (1.0,), _lost(name)) for name in names)


def _lost(name: str) -> Callable[[float], dict[str, Any]]:
    return lambda size: {"randomize": {}, "lost_camera": name}


def worlds(config: Config, wanted: Sequence[Disturbance] | None = None) -> Iterator[tuple[Score, dict[str, Any]]]:
    """All worlds, the clean one first: a score without its numbers, and the environment's arguments.

    What a run was trained with at random, `randomize` and `camera_loss`, is replaced.

    Args:
        config: Of a run.
        wanted: The disturbances; None for all, each camera's loss among them.

    Raises:
        ConfigError: If the environment cannot be disturbed.
    """
    nan = float("nan")
    steady = {name: value for name, value in config.env_kwargs.items() if name != "camera_loss"}
    kwargs = {**steady, "randomize": {}}
    try:
        check_env_kwargs(config.env_id, kwargs)
    except ConfigError as error:
        raise ConfigError(f"{config.env_id} has no argument 'randomize', so there is nothing to disturb") from error
    yield Score(CLEAN, "", "", nan, "", nan, nan, nan, 0), kwargs
    for change in [*DISTURBANCES, *camera_losses(config)] if wanted is None else wanted:
        for grade, size in zip(change.grades, change.sizes, strict=True):
            score = Score(change.kind, change.family, grade, size, change.unit, nan, nan, nan, 0)
            yield score, {**steady, **change.settings(size)}


def score_disturbances(
    model: BaseAlgorithm,
    config: Config,
    initial_states: Sequence[InitialState],
    n_envs: int = 1,
    wanted: Sequence[Disturbance] | None = None,
    progress: Callable[[int], object] = lambda n_done: None,
) -> list[Score]:
    """Score an agent in all worlds.

    Args:
        model: The agent.
        config: Of its run.
        initial_states: Resets to begin from, the same in every world.
        n_envs: Environments that are stepped together.
        wanted: The disturbances; None for all, as in `worlds`.
        progress: Called with the number of worlds that are done.
    """
    scores = []
    for score, kwargs in worlds(config, wanted):
        env_fn = make_env(config.env_id, kwargs, config.env_wrapper)
        result = evaluate(model, env_fn, initial_states, n_envs, VEC_ENVS["subproc" if n_envs > 1 else "dummy"])
        scores.append(_filled(score, result))
        progress(len(scores))
    return scores


def _filled(score: Score, result: Evaluation) -> Score:
    names = ("success_rate", "mean_steps_capped", "within_5cm", "n_poses")
    return Score(**{**asdict(score), **{name: getattr(result, name) for name in names}})


def mean_success(scores: Sequence[Score], grade: str | None = None) -> float:
    """Mean success over the worlds of a grade, or over all that are disturbed; NaN if there are none."""
    rates = [score.success_rate for score in scores if score.kind != CLEAN and grade in (None, score.grade)]
    return sum(rates) / len(rates) if rates else float("nan")


def table(scores: Sequence[Score]) -> str:
    """A line per kind of change, with the size and the success of each grade, and the means."""
    by_kind: dict[str, dict[str, Score]] = {}
    for score in scores:
        by_kind.setdefault(score.kind, {})[score.grade] = score
    clean = by_kind.pop(CLEAN)[""]
    rows = [["change", *GRADES]]
    for kind, grades in by_kind.items():
        rows.append([kind, *(_cell(grades[grade]) if grade in grades else "" for grade in GRADES)])
    rows.append(["mean", *(f"{100 * mean_success(scores, grade):.0f} %" for grade in GRADES)])
    head = (
        f"undisturbed: {100 * clean.success_rate:.0f} % of {clean.n_poses} poses, {clean.mean_steps_capped:.2f} steps"
    )
    mean = f"mean over {len(scores) - 1} disturbed worlds: {100 * mean_success(scores):.0f} %"
    return f"{head}; {mean}\n{aligned(rows, right=False)}"


def _cell(score: Score) -> str:
    return f"{100 * score.success_rate:.0f} % at {score.size:g} {score.unit}".rstrip()


def write_scores(file: Path, scores: Sequence[Score]) -> None:
    """Write a CSV file with a line per world.

    Raises:
        ConfigError: If it cannot be written.
    """
    try:
        with file.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(asdict(scores[0])))
            writer.writeheader()
            writer.writerows(asdict(score) for score in scores)
    except OSError as error:
        raise ConfigError(f"cannot write '{file}' ({error.strerror}); choose another with -o") from error


def read_scores(lines: Sequence[Mapping[str, str]]) -> list[Score]:
    """Return the scores of such a file's rows."""
    kinds = {field.name: {"str": str, "float": float, "int": int}[str(field.type)] for field in fields(Score)}
    rows: list[dict[str, Any]] = [{name: kind(row[name]) for name, kind in kinds.items()} for row in lines]
    return [Score(**row) for row in rows]


def draw(agents: Mapping[str, Sequence[Score]], file: Path) -> None:
    """Draw success over the grade, a panel per family and a curve per kind.

    Args:
        agents: Scores by the name of the agent; several are drawn with different lines.
        file: Where the picture goes.

    Raises:
        ConfigError: If it cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    families = list(dict.fromkeys(change.family for change in DISTURBANCES))
    figure, axes = plt.subplots(2, 3, figsize=(12, 7), layout="constrained", sharex=True, sharey=True)
    for panel, family in zip(axes.flat, families, strict=True):
        for scores, style in zip(agents.values(), ("-o", ":x", "--s", "-.d"), strict=False):
            _draw_family(panel, scores, family, style)
        panel.set(title=family, ylim=(-3, 103), xticks=range(1 + len(GRADES)), xticklabels=["none", *GRADES])
        panel.grid(alpha=0.3)
        handles, labels = panel.get_legend_handles_labels()
        unique = dict(zip(labels, handles, strict=True))
        panel.legend(unique.values(), unique.keys(), fontsize="x-small", loc="lower left")
    names = "; ".join(f"{style[:-1]} {name}" for name, style in zip(agents, ("-o", ":x", "--s", "-.d"), strict=False))
    figure.supylabel("success [%]")
    figure.suptitle(f"Success in disturbed worlds: {names}", fontsize="medium")
    save_figure(figure, file)


def _draw_family(panel: Any, scores: Sequence[Score], family: str, style: str) -> None:
    clean = next(score for score in scores if score.kind == CLEAN)
    kinds = dict.fromkeys(score.kind for score in scores if score.family == family)
    for number, kind in enumerate(kinds):
        points = [(0, clean.success_rate)]
        points += [(1 + GRADES.index(s.grade), s.success_rate) for s in scores if s.kind == kind]
        places, rates = zip(*points, strict=True)
        panel.plot(
            places, [100 * rate for rate in rates], style, color=f"C{number}", markersize=4, label=kind, alpha=0.8
        )
