"""The paper's protocol: evaluation on fixed test poses, and learning curves."""

from sb3_stereo.evaluation.protocol import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
