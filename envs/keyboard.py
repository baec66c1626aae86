"""The keyboard of Bullet's window: which keys push which joints."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.bullet import pybullet

FORWARD, BACK = "qwertyuio", "asdfghjkl"  # one key each for the first joint, the second, ...
NEW_EPISODE = "n"
FINE = pybullet.B3G_SHIFT
FINE_SHARE = 0.25  # of a full effort, while that is held
IS_DOWN = pybullet.KEY_IS_DOWN | pybullet.KEY_WAS_TRIGGERED  # the second one also for a key that is up again

Keys = Mapping[int, int]  # the code of each key that has moved or is down, and its state, as Bullet tells them


def is_down(keys: Keys, key: str | int) -> bool:
    """Return whether a key is down, or was since the keys were read last."""
    code = ord(key) if isinstance(key, str) else key
    return bool(keys.get(code, 0) & IS_DOWN)


def action_of(keys: Keys, n_joints: int) -> NDArray[np.float32] | None:
    """Return the action that the keys ask for, shape (n_joints,); None if no joint's key is down.

    A joint whose keys are both down rests; what shift makes finer are all of them.
    """
    pairs = list(zip(FORWARD, BACK))[:n_joints]
    if not any(is_down(keys, key) for pair in pairs for key in pair):
        return None
    share = FINE_SHARE if is_down(keys, FINE) else 1.0
    action = np.zeros(n_joints, np.float32)
    for joint, (forward, back) in enumerate(pairs):
        action[joint] = share * (is_down(keys, forward) - is_down(keys, back))
    return action


def legend(joints: Sequence[str]) -> str:
    """Return what the keys do, a line per joint."""
    width = max(map(len, joints))
    lines = [f"  {joint:<{width}}  {forward} / {back}" for joint, forward, back in zip(joints, FORWARD, BACK)]
    return "\n".join([*lines, f"  shift: a quarter of the effort; {NEW_EPISODE}: a new episode; Esc: the end"])
