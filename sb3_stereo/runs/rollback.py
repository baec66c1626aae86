"""The files of a run that belong to a snapshot: stored in it, and restored when training resumes from it.

They are small beside the replay buffer. So the directory is as it was then, whatever was written, cut or deleted since.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch as th

from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import BEST_MODEL, EVALUATIONS, checkpoint_name
from sb3_stereo.runs.files import sha256, write
from sb3_stereo.runs.models import CHECKSUMS, checksums, write_checksums

Files = dict[str, Any]
MONITORS = "*monitor.csv"


def capture_files(run: Path) -> Files:
    """Return the contents of a run's logs and best model, and the checksums of all its models."""
    paths = [*_logs(run), *run.glob(BEST_MODEL)]
    contents = {path.name: th.as_tensor(np.fromfile(path, np.uint8)) for path in paths}
    return {"contents": contents, "checksums": dict(checksums(run))}


def restore_files(run: Path, files: Files | None, step: int = 0) -> None:
    """Bring a run's files back to what was captured; what was damaged is made good, or a warning says so.

    Args:
        run: The run directory.
        files: From `capture_files`; None begins anew.
        step: When they were captured.
    """
    contents = _checked(files["contents"]) if files else {}
    listed: Mapping[str, str] = files["checksums"] if files else {}
    for path in [*_logs(run), *run.glob(BEST_MODEL)]:
        if path.name not in contents:
            path.unlink()
    for name, content in contents.items():
        if not _begins_with(run / name, b"" if name == BEST_MODEL else content):  # later ones are other models
            _warn(f"'{run / name}' was deleted, cut or changed; it is put back as it was at step {step}")
        write(run / name, content)
    if listed and not (run / CHECKSUMS).is_file():
        _warn(f"'{run / CHECKSUMS}' was deleted; it is put back as it was at step {step}")
    _restore_checksums(run, listed, step)


def _logs(run: Path) -> list[Path]:
    """The files that grow with the training."""
    return [*run.glob(MONITORS), *run.glob(EVALUATIONS)]


def _checked(contents: Mapping[str, th.Tensor]) -> dict[str, bytes]:
    """The contents by name, unless a name is none that `capture_files` gives."""
    for name in contents:
        is_log = Path(name).match(MONITORS) or name in (EVALUATIONS, BEST_MODEL)
        if not is_log or Path(name).name != name:
            raise ConfigError(f"a snapshot with the file '{name}' is not from a training; remove it")
    return {name: content.numpy().tobytes() for name, content in contents.items()}


def _begins_with(path: Path, content: bytes) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(content)) == content


def _restore_checksums(run: Path, listed: Mapping[str, str], step: int) -> None:
    """Name the models that are there: with the captured checksums, later ones with their own."""
    pairs = {*checksums(run), *listed.items()}
    whole = [(name, digest) for name, digest in pairs if (run / name).is_file() and sha256(run / name) == digest]
    for name in sorted(listed.keys() - dict(whole).keys() - {checkpoint_name(step)}):  # that one is saved again
        _warn(f"'{run / name}' was deleted or changed, and there is no other copy of it")
    write_checksums(run, whole)


def _warn(sentence: str) -> None:
    warnings.warn(sentence, stacklevel=3)
