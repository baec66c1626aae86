"""Snapshots as they are read: plain data with the parts that a training run writes, however right their digest is."""

from pathlib import Path
from typing import Any

import torch as th

from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.archives import MIB, load_tensors

FORMAT = 2  # of a snapshot; before version 0.1.0 it had none
MAX_INDEX = 64 * MIB  # an action of a running episode takes about 250 bytes, beside what the networks take

_KINDS = {"format": int, "step": int, "training": dict, "files": dict, "events": dict}


def read_snapshot(path: Path) -> dict[str, Any]:
    """Return what a snapshot holds; of `training`, only that it is a map.

    Raises:
        ConfigError: If it is damaged, of an older version, or something else.
    """
    way_out = "remove it, and the one before it is used"
    try:
        with path.open("rb") as file:
            state = load_tensors(file, MAX_INDEX)
    except ValueError as error:
        raise ConfigError(f"'{path}' holds more than plain data, which is not loaded ({error}); {way_out}") from error
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        other = "go on with the version that made it (see versions.yml), or begin with its models: -i best_model.zip"
        raise ConfigError(f"'{path}' was made by an older version of sb3_stereo; {other}")
    for key, kind in _KINDS.items():
        if type(state.get(key)) is not kind:
            raise ConfigError(f"'{path}' is not a snapshot: its '{key}' must be of type {kind.__name__}; {way_out}")
    if not _are_files(state["files"]) or not _are_sizes({"step": state["step"], **state["events"]}):
        raise ConfigError(f"'{path}' is not a snapshot: its files are none that a training run writes; {way_out}")
    return state


def _are_files(files: dict[Any, Any]) -> bool:
    """Whether it has contents as bytes and checksums as texts, by names without folders."""
    contents, checksums = files.get("contents"), files.get("checksums")
    if not isinstance(contents, dict) or not isinstance(checksums, dict):
        return False
    are_bytes = all(
        isinstance(item, th.Tensor) and item.dtype == th.uint8 and item.dim() == 1 for item in contents.values()
    )
    are_names = all(isinstance(name, str) and Path(name).name == name for name in [*contents, *checksums])
    return are_bytes and are_names and all(isinstance(digest, str) for digest in checksums.values())


def _are_sizes(sizes: dict[Any, Any]) -> bool:
    return all(isinstance(name, str) and type(size) is int and size >= 0 for name, size in sizes.items())
