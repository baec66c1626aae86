"""What the commands have in common: flags with the zoo's names, and errors in one sentence."""

import argparse
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from sb3_stereo import runtime
from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import surviving_broken_pipes
from sb3_stereo.errors import ConfigError, one_line
from sb3_stereo.runs.directory import LAST_CHECKPOINT

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from sb3_stereo.config.schema import Config

MAX_PATH, MAX_NAME = 4000, 255  # [bytes], Linux's limits; a run's files have longer paths than its folder
INTERRUPTED = 130  # 128 + SIGINT, the shell's convention


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one sentence, without the usage."""

    def error(self, message: str) -> NoReturn:
        """Print the message and leave with status 2."""
        self.exit(2, f"error: {one_line(message)} (see --help)\n")


def at_least(lowest: int, besides: int | None = None) -> Callable[[str], int]:
    """Return argparse's type for an integer from `lowest` on, or the one that stands for a default."""

    def count(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = lowest - 1 if besides != lowest - 1 else lowest - 2
        if number < lowest and number != besides:
            default = "" if besides is None else f", or {besides} for the default"
            raise argparse.ArgumentTypeError(f"{text!r} is no integer of at least {lowest}{default}")
        return number

    return count


def path(text: str) -> str:
    """argparse's type for a path that a file can have."""
    try:
        os.fsencode(text).decode("utf-8")
    except (UnicodeDecodeError, UnicodeEncodeError):
        raise argparse.ArgumentTypeError(f"{text!a} is not UTF-8; rename it") from None
    too_long = len(os.fsencode(text)) > MAX_PATH or any(len(os.fsencode(part)) > MAX_NAME for part in text.split("/"))
    if not text or "\0" in text or too_long:
        what = "is empty" if not text else "has a NUL in it" if "\0" in text else "is too long"
        raise argparse.ArgumentTypeError(f"the path {what}; give one that a file can have")
    return text


def file(text: str) -> Path:
    """argparse's type for a `Path` that a file can have."""
    return Path(path(text))


def add_process_flags(parser: argparse.ArgumentParser, num_threads: int = -1) -> None:
    """Add the flags for device, threads and packages.

    Args:
        parser: Where to add them.
        num_threads: The default; -1 stands for the free cores.
    """
    threads = "as many as there are free cores, up to 4" if num_threads < 0 else str(num_threads)
    parser.add_argument("--device", default="auto", help="PyTorch device, e.g. cpu, cuda (default: auto)")
    parser.add_argument(
        "--num-threads", type=at_least(1, -1), default=num_threads, help=f"PyTorch threads (default: {threads})"
    )
    parser.add_argument(
        "--gym-packages",
        nargs="+",
        default=[],
        metavar="PACKAGE",
        help="packages that register further environments, or have classes that the YAML names",
    )
    parser.add_argument(
        "--verbose", type=at_least(0), default=1, help="0 silent, 1 progress, 2 SB3's tables (default: 1)"
    )


def add_run_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that choose a run."""
    parser.add_argument("--algo", default="ddpg", help="ddpg, dqn, td3, sac, ppo, crossq or tqc (default: ddpg)")
    parser.add_argument("--env", default=DEFAULT_ENV, help=f"environment id (default: {DEFAULT_ENV})")
    parser.add_argument("-f", "--log-folder", "--folder", type=path, default="logs", help="log folder (default: logs)")


def add_model_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that choose one of a run's models; without any it is the final one."""
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--load-best", action="store_true", help="load best_model.zip instead of the final model")
    choice.add_argument("--load-checkpoint", type=at_least(0), metavar="N", help="load rl_model_N_steps.zip")
    choice.add_argument(
        "--load-last-checkpoint",
        dest="load_checkpoint",
        action="store_const",
        const=LAST_CHECKPOINT,
        help="load the newest of them",
    )
    parser.add_argument("--trust", action="store_true", help="load a model from elsewhere, with the code it may hold")


def add_repository_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that choose a repository of the Hugging Face Hub; those of two words are the zoo's."""
    owner = parser.add_mutually_exclusive_group()
    owner.add_argument("--repo-id", metavar="OWNER/NAME", help="the repository")
    owner.add_argument("-orga", "--organization", metavar="OWNER", help="its owner, a person or an organization")
    parser.add_argument("-name", "--repo-name", metavar="NAME", help="its name, with -orga (default: ALGO-ENV)")


def add_dataset_flags(parser: argparse.ArgumentParser, required: bool) -> None:
    """Add the flags that name a new dataset of episodes."""
    parser.add_argument(
        "--dataset",
        required=required,
        metavar="NAME",
        help="the new dataset of the episodes, e.g. wam/reach-v0 for Minari, me/wam-reach for LeRobot",
    )
    parser.add_argument(
        "--format",
        choices=("minari", "lerobot"),
        default="minari",
        help="minari: into MINARI_DATASETS_PATH (~/.minari/datasets); lerobot: a LeRobotDataset v3, into "
        "HF_LEROBOT_HOME (~/.cache/huggingface/lerobot) (default: minari)",
    )
    parser.add_argument("--author", help="who made the Minari dataset")


def check_display(way_out: str) -> None:
    """Raise a ConfigError if there is no display to open Bullet's window on."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise ConfigError(f"there is no display to open a window on; {way_out}")


def check_device(device: str) -> None:
    """Raise a ConfigError unless torch knows the device and it is there."""
    import torch as th

    try:
        if device != "auto":
            th.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"device '{device}' cannot be used ({reason}); cpu always works") from error


def load_agent(args: argparse.Namespace, run: str | Path) -> "tuple[Config, Path, BaseAlgorithm]":
    """Load the model of a run that the flags choose.

    Returns:
        The configuration with which it is evaluated or shown, the model's file and the model.
    """
    from sb3_stereo.runs.directory import import_packages, load_record, model_path
    from sb3_stereo.runs.models import load_model

    import_packages(args.gym_packages)
    check_device(args.device)
    config, _ = load_record(run)
    file = model_path(run, config.env_id, args.load_best, args.load_checkpoint)
    runtime.set_threads(args.num_threads)
    return config.evaluated, file, load_model(config, file, args.device, args.trust)


def run_command(command: Callable[[Any], int], args: Any) -> int:
    """Run a command; wrong input becomes one sentence on stderr and status 2.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    with surviving_broken_pipes():
        try:
            return command(args)
        except ConfigError as error:
            if getattr(args, "verbose", 1) > 1 and error.__cause__ is not None:
                traceback.print_exception(error.__cause__)
            print(f"error: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            return INTERRUPTED
