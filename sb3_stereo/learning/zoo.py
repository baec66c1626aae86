"""Our algorithms for rl-baselines3-zoo, under the names that its `--algo` knows."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from sb3_stereo.learning.stereo_ddpg import StereoDDPG, StereoTD3
from sb3_stereo.learning.stereo_dqn import StereoDQN
from sb3_stereo.learning.stereo_sac import StereoSAC


def register(algorithms: dict[str, Any]) -> None:
    """Replace the zoo's entries; without our settings ours are the ones they replace, bit for bit.

    Args:
        algorithms: `rl_zoo3.ALGOS`.
    """
    algorithms.update(ddpg=StereoDDPG, td3=StereoTD3, dqn=StereoDQN, sac=StereoSAC)
    if find_spec("sb3_contrib"):
        from sb3_stereo.learning.contrib import StereoCrossQ, StereoTQC

        algorithms.update(crossq=StereoCrossQ, tqc=StereoTQC)
