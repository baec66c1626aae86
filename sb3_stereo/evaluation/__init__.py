"""The paper's protocol: an agent on fixed test poses, its scores and learning curves."""

from sb3_stereo.evaluation.protocol import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
