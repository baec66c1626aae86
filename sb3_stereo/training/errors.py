"""External failures that can end a training run, as one sentence that says how to resume."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sb3_stereo.building.workers import WorkerDied
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import how_to_resume
from sb3_stereo.runs.files import disk_error

# A disk that is full or broken, or that may no longer be written.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


class Refused(ConfigError):
    """A training that did not begin."""


@contextmanager
def losses_are_errors(run: Path) -> Iterator[None]:
    """Tell of a dead process or a disk that cannot be written how to go on."""
    try:
        yield
    except WorkerDied as error:
        raise ConfigError(f"{error.what}; see that there is memory for it, then {how_to_resume(run)}") from error
    except (OSError, RuntimeError) as error:
        cause = disk_error(error)
        if cause is None or not _concerns(run, cause):
            raise
        way_out = f"make room, then {how_to_resume(run)}"
        raise ConfigError(f"cannot write to '{run}' ({cause.strerror}); {way_out}") from error


def _concerns(run: Path, error: OSError) -> bool:
    """Whether an error is the disk's, or of a file of the run that may not be written."""
    named = isinstance(error.filename, str | Path) and Path(error.filename).is_relative_to(run)
    return error.errno in DISK or (isinstance(error, PermissionError) and named)
