"""The run directory, laid out as rl-baselines3-zoo does: names, records, models.

logs/ddpg/WamStereoReach-v0_1/
    0.monitor.csv  evaluations.csv  best_model.zip  WamStereoReach-v0.zip  rl_model_2000_steps.zip
    WamStereoReach-v0/config.yml  args.yml  command.txt  versions.yml
"""

import csv
import os
import re
import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import yaml

from sb3_stereo import __version__
from sb3_stereo.config.schema import Config, check_env_id, parse_config
from sb3_stereo.console import command_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.files import replacing

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

BEST_MODEL = "best_model.zip"
EVALUATIONS = "evaluations.csv"
UNREADABLE = (KeyError, TypeError, ValueError, csv.Error)  # what a damaged table raises
ARGUMENTS = "args.yml"
CHECKPOINT_PREFIX = "rl_model"
PACKAGES = ("stable-baselines3", "sb3-contrib", "gymnasium", "torch", "numpy", "opencv-python-headless", "pybullet")


def env_name(env_id: str) -> str:
    """Return the environment's name in file names."""
    return env_id.rpartition(":")[2].replace("/", "-")


def run_ids(log_folder: Path, algo: str, env_id: str) -> list[int]:
    """Return the numbers of the existing runs, ascending."""
    return _numbers(log_folder / algo, env_name(env_id))


def create_run(log_folder: str | Path, algo: str, env_id: str) -> Path:
    """Make and return the directory of the next run, even if other processes do the same at the same time."""
    try:
        run = make_numbered(Path(log_folder) / algo, env_name(env_id))
        (run / env_name(env_id)).mkdir()
        return run
    except OSError as error:
        raise ConfigError(f"cannot write to '{log_folder}' ({error.strerror}); choose a log folder with -f") from error


def make_numbered(parent: Path, name: str) -> Path:
    """Make and return the folder `name_N` with the next free number."""
    parent.mkdir(parents=True, exist_ok=True)
    while True:
        folder = parent / f"{name}_{max(_numbers(parent, name), default=0) + 1}"
        try:
            folder.mkdir()
        except FileExistsError:  # another process was faster
            continue
        return folder


def _numbers(parent: Path, name: str) -> list[int]:
    """The numbers N of the folders `name_N`, ascending."""
    pattern = re.compile(re.escape(name) + r"_(\d+)")
    matches = (pattern.fullmatch(path.name) for path in parent.glob("*") if path.is_dir())
    return sorted(int(match[1]) for match in matches if match)


def save_records(run: Path, config: Config, args: Mapping[str, Any]) -> None:
    """Write what made the run: resolved configuration, arguments, command and versions."""
    folder = run / env_name(config.env_id)
    (folder / "command.txt").write_text(shlex.join(sys.orig_argv) + "\n", encoding="utf-8")
    # The arguments come last: a run that has them has everything.
    records = {"versions.yml": versions(), "config.yml": config.plain(), ARGUMENTS: dict(args)}
    for name, content in records.items():
        with replacing(folder / name) as partial:
            partial.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def versions() -> dict[str, str]:
    """Return the versions of Python, of this package and of what it stands on."""
    found = {"python": sys.version.split()[0], "sb3_stereo": __version__}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # e.g. opencv-python instead of its headless sister
            found[name] = "unknown"
    return found


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
    """Return a run's configuration and the arguments of its command.

    Raises:
        ConfigError: If the directory holds no run.
    """
    file = _arguments_file(run)
    try:
        args, config = _read_map(file), _read_map(file.parent / "config.yml")
        algo, env_id, packages = args["algo"], args["env"], args.get("gym_packages") or []
        if not all(isinstance(name, str) for name in (algo, env_id, *packages)):
            raise TypeError("names are texts")
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"'{file.parent}' is not the record of a training ({type(error).__name__})") from error
    import_packages(packages)
    check_env_id(env_id)
    return parse_config(algo, env_id, config), args


def _read_map(file: Path) -> dict[str, Any]:
    """Return the map in a YAML file.

    Raises:
        OSError, yaml.YAMLError, TypeError, ValueError: If there is none.
    """
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise TypeError(f"not a map: {type(content).__name__}")
    return content


def _arguments_file(run: str | Path) -> Path:
    files = sorted(Path(run).glob(f"*/{ARGUMENTS}"))
    if len(files) != 1:
        raise ConfigError(f"'{run}' is not a run directory; give one such as logs/ddpg/WamStereoReach-v0_1")
    return files[0]


@contextmanager
def locked(run: str | Path) -> Iterator[None]:
    """Hold a run for this process; the system lets go of it when the process ends, however that happens.

    Raises:
        ConfigError: If another process holds it.
    """
    with _arguments_file(run).open("rb+") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise ConfigError(f"another process trains '{run}' now; wait for it, or stop it first") from error
        yield


def has_ended(run: str | Path, config: Config) -> bool:
    """Return whether a run was trained to its end, scored and saved."""
    if not (Path(run) / f"{env_name(config.env_id)}.zip").is_file():
        return False
    try:
        return max(scores_by_step(run), default=0) >= config.n_timesteps
    except (OSError, *UNREADABLE):
        return False


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
    return f"go on with: {command_line('train', '--resume', os.path.relpath(run))}"


def how_to_watch(run: Path) -> str:
    """Return the command that plays a run's best model."""
    config, args = load_record(run)
    flags = ["--algo", config.algo, "--env", config.env_id, "-f", os.path.relpath(run.parent.parent)]
    if args.get("gym_packages"):
        flags += ["--gym-packages", *args["gym_packages"]]
    return command_line("enjoy", *flags, "--exp-id", run.name.rpartition("_")[2], "--load-best")


def import_packages(names: Any) -> None:
    """Import the packages that register further environments."""
    for name in names:
        try:
            import_module(name)
        except (Exception, SystemExit) as error:  # whatever a package does when it is imported
            reason = f"{type(error).__name__}: {error}" if not isinstance(error, ImportError) else str(error)
            raise ConfigError(f"cannot import the package '{name}' ({reason}); check --gym-packages") from error


def checkpoint_steps(run: Path) -> list[int]:
    """Return the steps at which checkpoints were saved, ascending."""
    matches = (re.fullmatch(CHECKPOINT_PREFIX + r"_(\d+)_steps\.zip", path.name) for path in run.iterdir())
    return sorted(int(match[1]) for match in matches if match)


def model_path(run: str | Path, env_id: str, best: bool = False, checkpoint: int | None = None) -> Path:
    """Return the file of a run's final model, of its best or of a checkpoint.

    Raises:
        ConfigError: If there is no such model; names those that exist.
    """
    run = Path(run)
    name = BEST_MODEL if best else f"{env_name(env_id)}.zip"
    if checkpoint is not None:
        name = f"{CHECKPOINT_PREFIX}_{checkpoint}_steps.zip"
    if not (run / name).is_file():
        existing = sorted(path.name for path in run.glob("*.zip"))
        raise ConfigError(
            f"no model '{name}' in '{run}'; models are: {', '.join(existing) or 'none'}"
            " (choose with --load-best or --load-checkpoint)"
        )
    return run / name
