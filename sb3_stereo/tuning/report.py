"""The results of a sweep: the table, the best setting as a YAML file to train with, and a plot."""

import csv
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from sb3_stereo.config.schema import overridden
from sb3_stereo.console import aligned, command_line
from sb3_stereo.tuning.config import Sweep
from sb3_stereo.tuning.records import Setting, Trial, read_folder, settings

BEST, PICTURE, TABLE = "best.yml", "slices.png", "trials.csv"
N_SHOWN = 10
FAILED = 1


def write_report(sweep: Sweep, folder: Path) -> str:
    """Write the table, the best YAML and the picture into the sweep's folder.

    Returns:
        What a person wants to see of it.
    """
    trials, others = read_folder(sweep, folder)
    found = settings(sweep, trials)
    left_out = [f"Left out: {other}" for other in others]
    if not found:
        return "\n".join(["No trial has begun yet.", *left_out])
    write_trials(sweep, trials, folder / TABLE)
    lines = [table(sweep, found), f"All {len(trials)} trials: {os.path.relpath(folder / TABLE)}", *left_out]
    if found[0].is_complete:
        write_best(sweep, found, folder / BEST)
        lines.append(f"The best setting: {os.path.relpath(folder / BEST)}")
        lines.append(picture_line(sweep, found, folder / PICTURE))
    else:
        lines.append("No setting is trained to the end with all seeds yet.")
    return "\n".join(lines)


def tell_failures(failures: Sequence[str]) -> int:
    """Print what failed, and return the command's exit status."""
    for failure in failures:
        print(f"failed: {failure}", file=sys.stderr)
    if failures:
        print("The same command tries what failed once more.", file=sys.stderr)
    return FAILED if failures else 0


def table(sweep: Sweep, found: Sequence[Setting]) -> str:
    """Return the best settings as a text table."""
    names = [parameter.name for parameter in sweep.parameters]
    rows = [[*names, sweep.metric.name, "seeds", "steps", "state", "runs"]]
    for setting in found[:N_SHOWN]:
        params = [format_value(setting.params.get(name)) for name in names]
        steps = min(trial.timesteps for trial in setting.trials)
        states = sorted({trial.state for trial in setting.trials})
        runs = [trial.run.name.rpartition("_")[2] for trial in setting.trials]
        progress = [f"{len(setting.trials)} of {len(sweep.seeds)}", str(steps), ", ".join(states), ",".join(runs)]
        rows.append([*params, f"{setting.score:.4g}", *progress])
    rest = len(found) - N_SHOWN
    return "\n".join([aligned(rows, right=False), *([f"  ... and {rest} more settings"] if rest > 0 else [])])


def format_value(value: Any) -> str:
    """Return a value as a table shows it."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def write_trials(sweep: Sweep, trials: Sequence[Trial], file: Path) -> None:
    """Write a line per trial."""
    names = [parameter.name for parameter in sweep.parameters]
    with file.open("w", newline="", encoding="utf-8") as output:
        writer = csv.writer(output, lineterminator="\n")
        writer.writerow(["run", "seed", "state", "timesteps", sweep.metric.name, *names])
        for trial in trials:
            values = [trial.params.get(name) for name in names]
            writer.writerow([trial.run.name, trial.seed, trial.state, trial.timesteps, trial.score, *values])


def write_best(sweep: Sweep, found: Sequence[Setting], file: Path) -> None:
    """Write the hyper-parameters of the best setting as a file for the training's `-conf`."""
    best, metric = found[0], sweep.metric
    config = overridden(sweep.base, best.params)
    seeds = f"the mean over {len(sweep.seeds)} seeds" if len(sweep.seeds) > 1 else f"seed {sweep.seeds[0]}"
    comment = (
        f"# The best of {len(found)} settings: {metric.name} {best.score:.4g}, {seeds}.\n"
        f"# {command_line('train', '--algo', config.algo, '--env', config.env_id, '-conf', os.path.relpath(file))}\n"
    )
    text = yaml.safe_dump({config.env_id: config.plain()}, sort_keys=False)
    file.write_text(comment + text, encoding="utf-8")


def picture_line(sweep: Sweep, found: Sequence[Setting], file: Path) -> str:
    """Write the study, draw its slices and say where they are, or what is missing for it."""
    try:
        from sb3_stereo.tuning.study import JOURNAL, draw_slices, write_study

        study = write_study(sweep, [setting for setting in found if setting.is_complete], file.parent)
        draw_slices(study, sweep, file)
    except ModuleNotFoundError as error:
        return f'No plot: it needs {error.name}; install it with: pip install "sb3_stereo[sweep]"'
    journal = os.path.relpath(file.parent / JOURNAL)
    return f"The metric over each parameter: {os.path.relpath(file)}\nFor optuna-dashboard: {journal}"
