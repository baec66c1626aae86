"""sb3-contrib's CrossQ and TQC, as `StereoSAC` is SB3's SAC (pip install 'sb3_stereo[contrib]')."""

from sb3_contrib import TQC, CrossQ

from sb3_stereo.learning.off_policy import OffPolicyMixin


class StereoCrossQ(OffPolicyMixin, CrossQ):
    """sb3-contrib's `CrossQ`; the further arguments are `OffPolicyMixin`'s."""


class StereoTQC(OffPolicyMixin, TQC):
    """sb3-contrib's `TQC`; the further arguments are `OffPolicyMixin`'s."""
