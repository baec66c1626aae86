"""SB3's SAC with a stereo replay buffer and pre-training."""

from stable_baselines3 import SAC

from sb3_stereo.learning.off_policy import OffPolicyMixin


class StereoSAC(OffPolicyMixin, SAC):
    """SB3's `SAC`; the further arguments are `OffPolicyMixin`'s."""
