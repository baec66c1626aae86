"""The agents that ship with the package: found by environment, and written from a run."""

import io
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch as th
import yaml

from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import command_line
from sb3_stereo.envs import TWIN_OF
from sb3_stereo.errors import ConfigError
from sb3_stereo.pretrained import FOLDER
from sb3_stereo.runs.archives import MIB, load_tensors, open_zip, read_member
from sb3_stereo.runs.directory import arguments_file, env_name, load_record, model_path, read_record, run_ids
from sb3_stereo.runs.files import sha256, write
from sb3_stereo.runs.models import NETWORKS, load_model, write_checksums

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

PRETRAINED = "pretrained"  # what stands for the agent's file in `train --trained-agent`
MAX_POLICY = 64 * MIB


def pretrained_run(algo: str, env_id: str, folder: Path = FOLDER) -> Path:
    """Return the run directory of the agent that ships for an algorithm and an environment.

    For a task in another simulator, it is the one that was trained on the same task in Bullet.

    Raises:
        ConfigError: If there is none; names those that exist.
    """
    for trained_on in (env_id, TWIN_OF.get(env_id, env_id)):
        if run_ids(folder, algo, trained_on):
            return folder / algo / f"{env_name(trained_on)}_1"
    shipped = ", ".join(f"{algo} on {name}" for algo, name in pretrained_names(folder))
    raise ConfigError(
        f"no trained agent of {algo} on {env_id} ships with this package, only {shipped}; "
        f"train one with: {command_line('train', '--algo', algo, '--env', env_id)}"
    )


def load_pretrained(env_id: str = DEFAULT_ENV, algo: str = "ddpg", device: str = "auto") -> "BaseAlgorithm":
    """Return the agent that ships for an environment, for acting: SB3's algorithm with an empty replay buffer.

    Raises:
        ConfigError: If none ships; a ValueError that names those that do.
    """
    run = pretrained_run(algo, env_id)
    config, _ = load_record(run)
    return load_model(config, model_path(run, config.env_id), device)


def pretrained_model(algo: str, env_id: str) -> Path:
    """Return the model of `pretrained_run`.

    Raises:
        ConfigError: If there is none.
    """
    run = pretrained_run(algo, env_id)
    return model_path(run, read_record(run).env_id)


def ships(algo: str, env_id: str) -> bool:
    """Whether there is an agent of `pretrained_run`."""
    return (algo, TWIN_OF.get(env_id, env_id)) in pretrained_names()


def pretrained_names(folder: Path = FOLDER) -> list[tuple[str, str]]:
    """Return algorithm and environment of all agents that ship."""
    records = [read_record(run) for run in sorted(folder.glob("*/*_1"))]
    return [(record.algo, record.env_id) for record in records]


def export(run: Path, folder: Path = FOLDER, best: bool = False) -> Path:
    """Write a run's agent as one that ships: its record and scores, and its networks alone in half precision.

    Args:
        run: The run directory.
        folder: The log folder to write into.
        best: Take the best model instead of the final one.

    Returns:
        The new run directory.

    Raises:
        ConfigError: If the run or its model cannot be read.
    """
    record = read_record(run)
    name = env_name(record.env_id)
    target = folder / record.algo / f"{name}_1"
    (target / name).mkdir(parents=True, exist_ok=True)
    source = arguments_file(run)
    write(target / name / source.name, yaml.safe_dump(shareable(record.args), sort_keys=False).encode())
    for file in ("config.yml", "versions.yml"):
        shutil.copyfile(source.with_name(file), target / name / file)
    shutil.copyfile(run / "evaluations.csv", target / "evaluations.csv")
    model = target / f"{name}.zip"
    write(model, _slim(model_path(run, record.env_id, best)))
    write_checksums(target, [(model.name, sha256(model))])
    return target


def shareable(args: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record's arguments without the places of the machine that trained it.

    What they said of settings is in `config.yml`.
    """
    places = (
        *("conf_file", "hyperparams", "env_kwargs", "eval_env_kwargs"),
        *("trained_agent", "resume", "tensorboard_log", "tensorboard"),
    )
    return {**args, **{key: None for key in places if key in args}, "log_folder": "logs"}


def _slim(path: Path) -> bytes:
    """The networks of a saved model in half precision, as a zip file of the same layout."""
    with path.open("rb") as file, open_zip(file) as archive:
        state: dict[str, Any] = load_tensors(io.BytesIO(read_member(archive, NETWORKS, MAX_POLICY)))
    halved = {name: value.half() if value.dtype == th.float32 else value for name, value in state.items()}
    networks, slim = io.BytesIO(), io.BytesIO()
    th.save(halved, networks)
    with zipfile.ZipFile(slim, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo(NETWORKS), networks.getvalue(), zipfile.ZIP_DEFLATED)
    return slim.getvalue()
