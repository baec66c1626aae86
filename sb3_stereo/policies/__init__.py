"""The networks: policies for SB3's algorithms, and their encoder."""

from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.sac_ppo import StereoPPOPolicy, StereoSACPolicy

__all__ = ["StereoCnn", "StereoDDPGPolicy", "StereoDQNPolicy", "StereoPPOPolicy", "StereoSACPolicy"]
