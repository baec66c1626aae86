"""Validation of the reaching environment's arguments and of those of its methods."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.composite import HEIGHT, WIDTH
from sb3_stereo.envs.specs import quoted, require, require_known
from sb3_stereo.envs.validation import MAX_NUMBER, Flag, Integer, Number, fit

Floats = NDArray[np.float64]
Positive = Annotated[Number, Field(gt=0)]

MAX_PULSE_STEPS = 100_000  # some seconds of computing
PhysicsRate = Annotated[Number, Field(ge=240, le=100_000)]  # [Hz]
RESET_OPTIONS = ("joint_positions", "target_position")
SUCCESS_FRAMES = ("frame", "observation")


def check_render_mode(mode: object, modes: Sequence[str]) -> None:
    """Raise a ValueError unless it is None or one of the modes."""
    known = mode is None or (isinstance(mode, str) and mode in modes)
    choices = ", ".join(repr(choice) for choice in (None, *modes))
    require(known, f"unknown render_mode {quoted(mode)}; it is one of {choices}")


def check_flags(**flags: object) -> None:
    """Raise a ValueError unless all are true or false."""
    for name, flag in flags.items():
        fit(flag, Flag, name)


def check_pictures(views: Sequence[CameraSpec]) -> None:
    """Raise a ValueError unless all pictures have one size."""
    sizes = {f"{view.width} x {view.height}" for view in views}
    require(len(sizes) == 1, f"cameras of {', '.join(sorted(sizes))} px; give all the same size")


def checked_min_views(min_views: Any, n_views: int) -> int:
    """Fewest views that must see both markers for a goal; None is all."""
    if min_views is None:
        return n_views
    fewest: int = fit(min_views, Integer, "min_views")
    wanted = f"give an integer from 1 to {n_views}, the number of cameras"
    require(1 <= fewest <= n_views, f"min_views is {fewest}; {wanted}")
    return fewest


def lost_views(lost_camera: Any, views: Sequence[CameraSpec]) -> frozenset[int]:
    """Numbers of the views of the camera that is lost; None is none."""
    names = [view.name for view in views]
    if lost_camera is not None:
        require_known("lost_camera", lost_camera, dict.fromkeys(names), "the cameras")
    return frozenset(number for number, name in enumerate(names) if name == lost_camera)


def success_scale(success_frame: object, view: CameraSpec, rho: float) -> Floats:
    """Pixels of the success frame per pixel of a camera's frame, shape (2,): along its width and its height.

    Raises:
        ValueError: If the success frame is unknown, or no distance in it is more than `rho`.
    """
    require_known("success_frame", success_frame, SUCCESS_FRAMES, "success frames")
    frame = np.array([view.width, view.height], dtype=np.float64)
    size = frame if success_frame == "frame" else np.array([WIDTH, HEIGHT], dtype=np.float64)
    diagonal = math.hypot(*size)
    require(rho < diagonal, f"rho is {rho:g}; give less than {diagonal:.0f} px, the diagonal of a picture")
    return size / frame


def checked_reset_options(options: Any) -> Mapping[str, Any]:
    """`reset`'s options, with names that are known; None is no options."""
    options = {} if options is None else options
    known = ", ".join(RESET_OPTIONS)
    require(isinstance(options, Mapping), f"the reset options are {quoted(options)}; give a map of {known}")
    for name in options:
        require(name in RESET_OPTIONS, f"unknown reset option {quoted(name)}; options are {known}")
    checked: Mapping[str, Any] = options
    return checked


def checked_seed(seed: Any) -> int | None:
    """`reset`'s seed as Gymnasium takes it; NumPy's integers are integers."""
    integer = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    require(seed is None or (integer and seed >= 0), f"seed is {quoted(seed)}; give an integer of at least 0, or None")
    return None if seed is None else int(seed)


def timing(physics_rate: Any, pulse_duration: Any) -> tuple[float, int]:
    """The simulation's rate in [Hz] and the steps that a pulse takes."""
    rate: float = fit(physics_rate, PhysicsRate, "physics_rate")
    n_steps = rate * fit(pulse_duration, Positive, "pulse_duration")
    so_many = f"pulse_duration is {quoted(pulse_duration)}, which takes {n_steps:.3g} simulation steps"
    require(n_steps <= MAX_PULSE_STEPS, f"{so_many}; give a shorter one, of at most {MAX_PULSE_STEPS} steps")
    return rate, max(1, round(n_steps))


def bounded(name: str, value: Any, size: int) -> Floats:
    """`value` as a vector of numbers that physics can bear."""
    checked = vector(name, value, size)
    require(np.abs(checked).max() <= MAX_NUMBER, f"{name} is {checked.tolist()}; give at most {MAX_NUMBER:g}")
    return checked


def vector(name: str, value: Any, size: int) -> Floats:
    """`value` as a finite vector of `size` numbers, a copy."""
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} is {quoted(value)}; give {size} numbers") from None
    if numbers.shape != (size,):
        raise ValueError(f"{name} has shape {numbers.shape}; give ({size},)")
    if not np.isfinite(numbers).all():  # not `require`: every step comes by, and the sentence takes longer to write
        raise ValueError(f"{name} is {numbers.tolist()}; give finite numbers")
    return numbers
