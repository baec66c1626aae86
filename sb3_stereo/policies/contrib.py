"""Policies for sb3-contrib's CrossQ and TQC, like those in `sac_ppo` (pip install 'sb3_stereo[contrib]')."""

from sb3_contrib.crossq.policies import CrossQPolicy
from sb3_contrib.tqc.policies import TQCPolicy

from sb3_stereo.policies.sac_ppo import StereoEncoder


class StereoCrossQPolicy(StereoEncoder, CrossQPolicy):
    """sb3-contrib's `CrossQPolicy` on stereo images."""


class StereoTQCPolicy(StereoEncoder, TQCPolicy):
    """sb3-contrib's `TQCPolicy` on stereo images."""
