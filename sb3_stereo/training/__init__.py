"""One training run, from its configuration to its result."""

from sb3_stereo.training.trainer import Options, Result, resume, train

__all__ = ["Options", "Result", "resume", "train"]
