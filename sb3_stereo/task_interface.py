"""What learner and tools ask of an environment: attributes, and keys of its `info`.

Attributes are asked through all wrappers. An environment may lack any of them: see `Task`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

# Keys of `info`, after every reset and step.
OFFSETS = "pixel_offsets"  # from the target to the end effector, (n_views, 2) in [px]; NaN where it is occluded
DISTANCES = "pixel_distances"  # their lengths, (n_views,) in [px]
PREVIOUS_OFFSETS = "previous_pixel_offsets"  # before the step, if all views saw both markers
TARGET = "target_pixels"  # where the target is in each view, (n_views, 2) in [px]; NaN where it is occluded
SUCCESS = "is_success"  # SB3's name


# From offsets before and after steps, (batch, n_views, 2) in [px], to rewards and whether the target is reached.
OffsetReward = Callable[[NDArray[Any], NDArray[Any]], tuple[NDArray[Any], NDArray[Any]]]


class StereoTask(Protocol):
    """The attributes."""

    n_views: int
    views_in_channels: bool  # each view is a channel, and not a part of the rows
    marker_map: bool  # every second channel shows where the markers are, and not luminance
    mirrored_joints: tuple[int, ...] | None  # action components that change sign in the mirror; None: no mirror image
    offset_reward: OffsetReward | None  # the reward as a function of offsets alone; None: it is none
    n_joints: int  # joints that one discrete action moves; `QuantizedActions` has it


@dataclass(frozen=True)
class Task:
    """What an environment says of itself.

    Attributes:
        n_views: Views in an image; a stereo pair if the environment does not say.
        views_in_channels: As in `StereoTask`; None if the environment does not say.
        marker_map: As in `StereoTask`; no if the environment does not say.
        mirrored_joints: As in `StereoTask`; None as well if the environment does not say.
        n_joints: As in `StereoTask`; None if the environment does not say.
        offset_reward: As in `StereoTask`; None as well if the environment does not say.
    """

    n_views: int = 2
    views_in_channels: bool | None = None
    marker_map: bool = False
    mirrored_joints: tuple[int, ...] | None = None
    n_joints: int | None = None
    offset_reward: OffsetReward | None = None


def env_attribute(env: VecEnv, name: str, default: Any = None) -> Any:
    """Return an attribute of the environments, through their wrappers; the default if they do not have it."""
    return env.get_attr(name)[0] if env.has_attr(name) else default


def task_of(env: VecEnv | None) -> Task:
    """Ask an environment for all attributes; a model that is loaded without one knows nothing of it."""
    if env is None:
        return Task()
    return Task(**{name: env_attribute(env, name, default) for name, default in vars(Task()).items()})


def agreed_n_views(env: VecEnv | None, settings: Mapping[str, Any], name: str) -> None:
    """Make sure that settings which have a number of views have the environment's.

    Raises:
        ValueError: If they do not.
    """
    n_views = task_of(env).n_views
    if env is not None and settings.get("n_views", n_views) != n_views:
        raise ValueError(f"{name}: n_views is {settings['n_views']}, and the environment has {n_views}; leave it out")


def check_offsets(env: VecEnv, n_views: int, needed_by: str) -> None:
    """Make sure that environments that have been reset say where the end effector is, in every view.

    Raises:
        ValueError: If they do not, or they have another number of views.
    """
    for info in env.unwrapped.reset_infos:  # a wrapper's own are empty
        if OFFSETS not in info:
            raise ValueError(
                f"{needed_by} needs info['{OFFSETS}'], which this environment does not give; "
                "leave it out and set encoder_loss to 'critic'"
            )
        if len(info[OFFSETS]) != n_views:
            raise ValueError(
                f"{needed_by} was made for {n_views} views, and info['{OFFSETS}'] has {len(info[OFFSETS])}; "
                "give the environment an attribute n_views that says so"
            )
