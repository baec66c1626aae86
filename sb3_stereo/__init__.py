"""Reach a target from two camera images, with Stable-Baselines3.

Importing this package registers the environments and loads neither torch nor PyBullet: the classes below are
imported when they are first used.
"""

import sys
from importlib import import_module
from typing import Any

from sb3_stereo import renamed
from sb3_stereo.envs import ENV_IDS

__version__ = "0.1.0"

_LAZY = {
    "AnnealExploration": "sb3_stereo.learning.callbacks",
    "AnnealedOrnsteinUhlenbeckNoise": "sb3_stereo.learning.exploration",
    "LearnFromMotion": "sb3_stereo.learning.callbacks",
    "StereoReplay": "sb3_stereo.learning.callbacks",
    "StereoReplayBuffer": "sb3_stereo.learning.replay",
    "RelabellingReplayBuffer": "sb3_stereo.learning.relabelling",
    "QuantizedActions": "sb3_stereo.envs.wrappers",
    "StereoCnn": "sb3_stereo.policies.extractors",
    "StereoCrossQ": "sb3_stereo.learning.contrib",
    "StereoDDPG": "sb3_stereo.learning.stereo_ddpg",
    "StereoDDPGPolicy": "sb3_stereo.policies.ddpg",
    "StereoDQN": "sb3_stereo.learning.stereo_dqn",
    "StereoSAC": "sb3_stereo.learning.stereo_sac",
    "StereoTD3": "sb3_stereo.learning.stereo_ddpg",
    "StereoTQC": "sb3_stereo.learning.contrib",
    "StereoCrossQPolicy": "sb3_stereo.policies.contrib",
    "StereoDQNPolicy": "sb3_stereo.policies.dqn",
    "StereoPPOPolicy": "sb3_stereo.policies.sac_ppo",
    "StereoSACPolicy": "sb3_stereo.policies.sac_ppo",
    "StereoTQCPolicy": "sb3_stereo.policies.contrib",
    "SwitchedAgent": "sb3_stereo.policies.switched",
    "film": "sb3_stereo.viz.film",
    "VolumeCnn": "sb3_stereo.policies.volume",
    "load_pretrained": "sb3_stereo.runs.pretrained",
    "WarmUp": "sb3_stereo.learning.callbacks",
}

__all__ = ["ENV_IDS", "__version__", *_LAZY]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LAZY[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


renamed.install()

if "rl_zoo3" in sys.modules:  # --gym-packages sb3_stereo brings our algorithms into the zoo, and not environments alone
    import_module("sb3_stereo.learning.zoo").register(sys.modules["rl_zoo3"].ALGOS)
