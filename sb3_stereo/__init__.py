"""Reach a target from two camera images, with Stable-Baselines3.

Importing this package registers the environments and loads neither torch nor PyBullet: the classes below are
imported when they are first used.
"""

from importlib import import_module
from typing import Any

from sb3_stereo import renamed
from sb3_stereo.envs import ENV_IDS

__version__ = "0.1.0"

_LAZY = {
    "AnnealExploration": "sb3_stereo.learning.exploration",
    "AnnealedOrnsteinUhlenbeckNoise": "sb3_stereo.learning.exploration",
    "LearnFromMotion": "sb3_stereo.learning.dynamics",
    "StereoReplay": "sb3_stereo.learning.replay",
    "StereoReplayBuffer": "sb3_stereo.learning.replay",
    "QuantizedActions": "sb3_stereo.envs.wrappers",
    "StereoCnn": "sb3_stereo.policies.extractors",
    "StereoDDPGPolicy": "sb3_stereo.policies.ddpg",
    "StereoCrossQPolicy": "sb3_stereo.policies.contrib",
    "StereoDQNPolicy": "sb3_stereo.policies.dqn",
    "StereoPPOPolicy": "sb3_stereo.policies.sac_ppo",
    "StereoSACPolicy": "sb3_stereo.policies.sac_ppo",
    "StereoTQCPolicy": "sb3_stereo.policies.contrib",
    "WarmUp": "sb3_stereo.learning.warmup",
}

__all__ = ["ENV_IDS", "__version__", *_LAZY]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LAZY[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


renamed.install()
