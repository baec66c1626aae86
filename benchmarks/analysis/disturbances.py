"""The disturbance suite's scores of recorded runs, and `benchmarks/ROBUSTNESS.md` with its picture.

    python -m benchmarks.analysis.disturbances RUN --name NAME

scores the run's final model as `python -m sb3_stereo evaluate RUN --disturbances` does, records it in
`benchmarks/results/disturbances.csv` and writes table and picture anew; without RUN it does only the last.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import benchmarks
from benchmarks.analysis.baselines import Line, read_lines, write_lines
from benchmarks.tables.row_tables import line_of
from sb3_stereo.commands.evaluate import N_DISTURBED
from sb3_stereo.commands.flags import Parser, at_least, run_command
from sb3_stereo.console import Bar, print_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.disturbances import (
    CLEAN,
    DISTURBANCES,
    GRADES,
    Score,
    draw,
    mean_success,
    read_scores,
    score_disturbances,
    worlds,
)
from sb3_stereo.evaluation.protocol import eval_initial_states
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model

# What a run of the name was trained with; the order is the table's.
LABELS = {
    "v1_ours_ddpg": "ours, clean images",
    "v1_robust_ddpg": "ours, augmented images",
    "v1_ours_dqn": "DQN, ours",
}
MANY = "`python -m sb3_stereo evaluate RUN --disturbances`"
TEXT = f"""# Success in disturbed worlds

{MANY} plays {N_DISTURBED} of the test poses in each world of the suite. One thing at a time is changed, by one of three
sizes; everything else is as in training. A cell is the success in %, the mean over seeds.
[Another light, noise, moved cameras, clutter](../docs/robustness.md) says what the changes are and how to train for
them.

This page is written by `python -m benchmarks.analysis.disturbances` from `benchmarks/results/disturbances.csv`.
"""


def record() -> Path:
    """The file with a line per agent and world."""
    return benchmarks.RESULTS / "disturbances.csv"


def score_run(run: Path, name: str, n_envs: int) -> list[Line]:
    """Score a run's final model in all worlds."""
    config, arguments = load_record(run)
    path = model_path(run, config.env_id)
    agent = {"row": name, "seed": str(arguments["seed"]), "timesteps": str(config.n_timesteps)}  # of the final model
    states = eval_initial_states(config.env_id, config.env_kwargs)[:N_DISTURBED]
    bar = Bar(sum(1 for _ in worlds(config, DISTURBANCES)), "world")
    try:
        scores = score_disturbances(load_model(config, path), config, states, n_envs, DISTURBANCES, bar.update)
    finally:
        bar.close()
    return [agent | {key: _text(value) for key, value in asdict(score).items()} for score in scores]


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def add_lines(lines: Sequence[Line]) -> None:
    """Put an agent's lines into the record, in place of those of an earlier scoring."""
    agent = lines[0]["row"], lines[0]["seed"]
    others = [line for line in read_lines(record()) if (line["row"], line["seed"]) != agent]
    order = list(LABELS)
    write_lines(record(), sorted([*others, *lines], key=lambda line: (order.index(line["row"]), int(line["seed"]))))


def agents() -> dict[str, list[list[Score]]]:
    """The recorded scores: by the agent's label, those of every seed."""
    found: dict[str, dict[str, list[Line]]] = {}
    for line in read_lines(record()):
        found.setdefault(LABELS[line["row"]], {}).setdefault(line["seed"], []).append(line)
    return {label: [read_scores(lines) for lines in seeds.values()] for label, seeds in found.items()}


def mean_over_seeds(seeds: Sequence[Sequence[Score]]) -> list[Score]:
    """One agent's scores with the mean success over its seeds."""
    means = [float(np.mean([score.success_rate for score in world])) for world in zip(*seeds, strict=True)]
    return [Score(**{**asdict(one), "success_rate": mean}) for one, mean in zip(seeds[0], means, strict=True)]


def page(found: dict[str, list[list[Score]]]) -> str:
    """The page: a column per agent and grade."""
    means = {label: mean_over_seeds(seeds) for label, seeds in found.items()}
    names = [f"{label} ({len(seeds)} seed{'s' * (len(seeds) > 1)})" for label, seeds in found.items()]
    head = ["change", "sizes", *names]
    kinds = list(dict.fromkeys((s.kind, s.unit) for s in next(iter(means.values())) if s.kind != CLEAN))
    rows = [["undisturbed", "", *(f"{100 * scores[0].success_rate:.0f}" for scores in means.values())]]
    for kind, unit in kinds:
        worlds = [[score for score in scores if score.kind == kind] for scores in means.values()]
        sizes = f"{' / '.join(f'{score.size:g}' for score in worlds[0])} {unit}".strip()
        rows.append([kind, sizes, *(" / ".join(f"{100 * s.success_rate:.0f}" for s in world) for world in worlds)])
    for grade in GRADES:
        rows.append([f"**mean, {grade}**", "", *(f"{100 * mean_success(s, grade):.0f}" for s in means.values())])
    rows.append(["**mean of all**", "", *(f"{100 * mean_success(scores):.0f}" for scores in means.values())])
    table = "\n".join(map(line_of, [head, ["---"] * len(head), *rows]))
    return f"{TEXT}\n{table}\n\n![Success over the size of the change](robustness.png)\n"


def write_page() -> None:
    """Write table and picture from the record."""
    found = agents()
    folder = benchmarks.RESULTS.parent
    (folder / "ROBUSTNESS.md").write_text(page(found), encoding="utf-8")
    draw({label: mean_over_seeds(seeds) for label, seeds in found.items()}, folder / "robustness.png")


def disturbances_command(args: argparse.Namespace) -> int:
    """Score a run if one is given, and write the page."""
    if args.run is not None:
        if args.name not in LABELS:
            raise ConfigError(f"unknown name {args.name!r}; the table's agents are {', '.join(LABELS)}")
        lines = score_run(Path(args.run), args.name, args.n_envs)
        add_lines(lines)
        print_line(f"{len(lines)} worlds recorded in {record()}")
    write_page()
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = Parser(prog="python -m benchmarks.analysis.disturbances", description=__doc__.splitlines()[0])
    parser.add_argument("run", nargs="?", metavar="RUN", help="the run's directory")
    parser.add_argument("--name", help=f"what it is a run of: {', '.join(LABELS)}")
    parser.add_argument("--n-envs", type=at_least(1), default=1, help="parallel environments (default: 1)")
    return run_command(disturbances_command, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
