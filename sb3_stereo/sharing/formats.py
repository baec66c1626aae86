"""The formats of datasets, by the name that `--format` has."""

from sb3_stereo.errors import ConfigError
from sb3_stereo.sharing.lerobot_dataset import LeRobotWriter
from sb3_stereo.sharing.minari_dataset import MinariWriter
from sb3_stereo.sharing.recording import DatasetWriter


def open_dataset(form: str, name: str, played_by: str, author: str | None = None) -> DatasetWriter:
    """Return the writer of a new dataset.

    Args:
        form: "minari" or "lerobot".
        name: The dataset's, as the format has them.
        played_by: Who acts, e.g. an algorithm.
        author: Who made it; None leaves that out. LeRobot's have none.

    Raises:
        ConfigError: If no such dataset can be made.
    """
    if form == "minari":
        return MinariWriter(name, played_by, author)
    if author is not None:
        raise ConfigError(f"--author is '{author}', and a LeRobot dataset has none; leave it out")
    return LeRobotWriter(name)
