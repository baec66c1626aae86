"""The run directory, laid out as rl-baselines3-zoo does: names, records, models. Nothing here writes.

logs/ddpg/WamStereoReach-v0_1/
    0.monitor.csv  evaluations.csv  best_model.zip  WamStereoReach-v0.zip  rl_model_2000_steps.zip
    WamStereoReach-v0/config.yml  args.yml  command.txt  versions.yml  status.yml
"""

import csv
import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym

from sb3_stereo.config.modules import import_packages as import_packages
from sb3_stereo.config.modules import is_installed
from sb3_stereo.config.schema import Config, check_env_id, parse_config
from sb3_stereo.console import command_line
from sb3_stereo.envs import plain_yaml
from sb3_stereo.errors import ConfigError

BEST_MODEL = "best_model.zip"
EVALUATIONS = "evaluations.csv"
UNREADABLE = (KeyError, TypeError, ValueError, csv.Error)  # what a damaged table raises
ARGUMENTS = "args.yml"
CHECKPOINT_PREFIX = "rl_model"
LAST_CHECKPOINT = -1  # in place of a step


def env_name(env_id: str) -> str:
    """Return the environment's name in file names."""
    return env_id.rpartition(":")[2].replace("/", "-")


def run_ids(log_folder: Path, algo: str, env_id: str) -> list[int]:
    """Return the numbers of the existing runs, ascending."""
    parent, name = log_folder / algo, env_name(env_id)
    return [number for number in numbers(parent, name) if (parent / f"{name}_{number}").is_dir()]


def numbers(parent: Path, name: str) -> list[int]:
    """Return the numbers N of whatever is called `name_N` in a folder, ascending."""
    pattern = re.compile(re.escape(name) + r"_(\d+)")
    matches = (pattern.fullmatch(path.name) for path in parent.glob("*"))
    return sorted(int(match[1]) for match in matches if match)


def find_run(log_folder: str | Path, algo: str, env_id: str, exp_id: int = 0) -> Path:
    """Return the directory of a run; `exp_id` 0 is the latest.

    Raises:
        ConfigError: If there is no such run.
    """
    ids = run_ids(Path(log_folder), algo, env_id)
    parent = Path(log_folder) / algo
    if not ids:
        how_to_train = command_line("train", "--algo", algo, "--env", env_id, "-f", str(log_folder))
        raise ConfigError(f"no run of {env_id} in '{parent}'; train one with: {how_to_train}")
    if exp_id and exp_id not in ids:
        raise ConfigError(f"no run {exp_id} of {env_id} in '{parent}'; runs are {', '.join(map(str, ids))}")
    return parent / f"{env_name(env_id)}_{exp_id or ids[-1]}"


def load_record(run: str | Path) -> tuple[Config, dict[str, Any]]:
    """Return a run's configuration and the arguments of its command. Nothing is imported because a record names it.

    Raises:
        ConfigError: If the directory holds no run, or the run needs packages that are not imported.
    """
    record = read_record(run)
    if record.env_id not in gym.registry and record.packages:
        what = f"'{run}' is of the environment '{record.env_id}', which no imported package registers"
        raise ConfigError(f"{what}; if you trust its record, add --gym-packages {' '.join(record.packages)}")
    check_env_id(record.env_id)
    return parse_config(record.algo, record.env_id, record.config), record.args


class Record(NamedTuple):
    """What a run's `args.yml` and `config.yml` say: names are texts, all else is unchecked."""

    algo: str
    env_id: str
    packages: list[str]
    config: dict[str, Any]
    args: dict[str, Any]


def read_record(run: str | Path) -> Record:
    """Return a run's record as it is written.

    Raises:
        ConfigError: If the directory holds no run, or its record is damaged.
    """
    file = arguments_file(run)
    try:
        args, config = _read_map(file), _read_map(file.with_name("config.yml"))
        algo, env_id, packages = args["algo"], args["env"], args.get("gym_packages") or []
        if not all(isinstance(name, str) for name in (algo, env_id, *packages, *args, *config)):
            raise TypeError("names are texts")
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"'{file.parent}' is not the record of a training ({type(error).__name__})") from error
    return Record(algo, env_id, list(packages), config, args)


def _read_map(file: Path) -> dict[Any, Any]:
    """Return the map in a YAML file.

    Raises:
        OSError, TypeError, ValueError: If there is none.
    """
    content = plain_yaml.read(file)
    if not isinstance(content, dict):
        raise TypeError(f"not a map: {type(content).__name__}")
    return content


def arguments_file(run: str | Path) -> Path:
    """Return the file of a run's arguments, beside which its other records are.

    Raises:
        ConfigError: If the directory holds no run.
    """
    files = sorted(Path(run).glob(f"*/{ARGUMENTS}"))
    if len(files) != 1:
        raise ConfigError(f"'{run}' is not a run directory; give one such as logs/ddpg/WamStereoReach-v0_1")
    return files[0]


def scores_by_step(run: str | Path) -> dict[int, dict[str, float]]:
    """Return a run's scores; a last row that was cut off while it was written is none.

    Raises:
        OSError: If there are none, or they cannot be read.
        KeyError, TypeError, ValueError, csv.Error: If they are damaged, see `UNREADABLE`.
    """
    with (Path(run) / EVALUATIONS).open(newline="", encoding="utf-8") as file:
        lines = file.readlines()
    while lines and not (lines[-1].endswith("\n") and lines[-1].count(",") == lines[0].count(",")):
        lines.pop()
    rows = csv.DictReader(lines)
    return {int(row["timesteps"]): {column: float(text) for column, text in row.items()} for row in rows}


def how_to_resume(run: Path) -> str:
    """Return the way out of an interruption, as a clause."""
    packages = [name for name in read_record(run).packages if not is_installed(name)]
    flags = ["--gym-packages", *packages] if packages else []
    return f"resume with: {command_line('train', '--resume', os.path.relpath(run), *flags)}"


def how_to_watch(run: Path) -> str:
    """Return the command that plays a run's best model."""
    config, args = load_record(run)
    flags = ["--algo", config.algo, "--env", config.env_id, "-f", os.path.relpath(run.parent.parent)]
    if args.get("gym_packages"):
        flags += ["--gym-packages", *args["gym_packages"]]
    return command_line("enjoy", *flags, "--exp-id", run.name.rpartition("_")[2], "--load-best")


def checkpoint_steps(run: Path) -> list[int]:
    """Return the steps at which checkpoints were saved, ascending."""
    matches = (re.fullmatch(CHECKPOINT_PREFIX + r"_(\d+)_steps\.zip", path.name) for path in run.iterdir())
    return sorted(int(match[1]) for match in matches if match)


def checkpoint_name(step: int) -> str:
    """Return the name of the model that was saved at a step, which is SB3's."""
    return f"{CHECKPOINT_PREFIX}_{step}_steps.zip"


def model_path(run: str | Path, env_id: str, best: bool = False, checkpoint: int | None = None) -> Path:
    """Return the file of a run's final model, of its best or of a checkpoint.

    Args:
        run: The run's directory.
        env_id: Of its environment.
        best: The best one.
        checkpoint: The step of one; `LAST_CHECKPOINT` is the newest.

    Raises:
        ConfigError: If there is no such model; names those that exist.
    """
    run = Path(run)
    name = BEST_MODEL if best else f"{env_name(env_id)}.zip"
    if checkpoint is not None:
        name = checkpoint_name(max(checkpoint_steps(run), default=0) if checkpoint == LAST_CHECKPOINT else checkpoint)
    if not (run / name).is_file():
        existing = sorted(path.name for path in run.glob("*.zip"))
        raise ConfigError(
            f"no model '{name}' in '{run}'; models are: {', '.join(existing) or 'none'}"
            " (choose with --load-best or --load-checkpoint)"
        )
    return run / name
