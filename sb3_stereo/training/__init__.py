"""One training run, from its configuration to its result."""

from sb3_stereo.training.options import Options, Result
from sb3_stereo.training.trainer import resume, train

__all__ = ["Options", "Result", "resume", "train"]
