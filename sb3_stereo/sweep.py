"""Sweep over hyper-parameters: `python -m sb3_stereo.sweep hyperparams/sweeps/ddpg_gamma.yml`."""

import argparse
import logging
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sb3_stereo.cli import Parser, add_process_flags, run_command
from sb3_stereo.errors import ConfigError
from sb3_stereo.runtime import available_cores

if TYPE_CHECKING:
    from sb3_stereo.tuning.config import Sweep

FAILED = 1


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(prog="sweep", description="Train the settings that a YAML file describes, on Ray Tune.")
    parser.add_argument("file", metavar="FILE", help="the sweep, e.g. hyperparams/sweeps/ddpg_gamma.yml")
    parser.add_argument("-f", "--log-folder", "--folder", default="logs", help="log folder (default: logs)")
    parser.add_argument("--address", help="a Ray cluster, e.g. auto or head:6379 (default: this machine alone)")
    parser.add_argument("--workers", type=int, default=0, help="trials at a time (default: as many as fit)")
    parser.add_argument(
        "--save-freq", type=int, default=1000, help="steps between a trial's checkpoints (default: 1000; -1: none)"
    )
    parser.add_argument("--report", action="store_true", help="train nothing, report what is there")
    add_process_flags(parser, num_threads=1)
    return parser


def sweep_command(args: argparse.Namespace) -> int:
    """Run what is missing of a sweep and report it."""
    from sb3_stereo.runs import import_packages
    from sb3_stereo.tuning.config import load_sweep
    from sb3_stereo.tuning.records import claim, is_done
    from sb3_stereo.tuning.report import write_report

    import_packages(args.gym_packages)
    sweep = load_sweep(args.file)
    check_flags(args, sweep)
    folder = Path(args.log_folder).absolute() / "sweeps" / Path(args.file).stem
    claim(sweep, folder)
    failures = [] if args.report or is_done(sweep, folder) else run_sweep(args, sweep, folder)
    print(write_report(sweep, folder))
    for failure in failures:
        print(f"failed: {failure}", file=sys.stderr)
    if failures:
        print("The same command tries what failed once more.", file=sys.stderr)
    return FAILED if failures else 0


def check_flags(args: argparse.Namespace, sweep: "Sweep") -> None:
    """Raise a ConfigError for flags that cannot be used."""
    if find_spec("ray") is None or find_spec("optuna") is None:
        raise ConfigError("sweeps need Ray Tune and Optuna; install them with: pip install 'sb3_stereo[sweep]'")
    if args.workers < 0:
        raise ConfigError(f"--workers must not be negative, got {args.workers}")
    if args.device.startswith("cuda") and sweep.resources.gpu == 0:
        raise ConfigError(f"--device {args.device} needs a GPU per trial; add it, as in resources: {{gpu: 0.25}}")


def run_sweep(args: argparse.Namespace, sweep: "Sweep", folder: Path) -> list[str]:
    """Run what is missing of a sweep, and return what failed."""
    with connected(args.address):
        from sb3_stereo.tuning.trials import Job, Watch, check_resources, fit

        check_resources(sweep.resources)
        packages, command = tuple(args.gym_packages), tuple(sys.orig_argv)
        job = Job(sweep, folder, args.device, args.num_threads, args.save_freq, packages, command)
        watch = Watch(job, args.verbose)
        try:
            fit(job, args.workers, [watch])
        except KeyboardInterrupt:
            print("Interrupted; the same command goes on.")
            raise
    return watch.failures


@contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Connect to a Ray cluster, or start one of this machine's cores; it ends with the context.

    Raises:
        ConfigError: If there is no cluster at the address.
    """
    os.environ.update(
        RAY_USAGE_STATS_ENABLED="0",
        TUNE_DISABLE_AUTO_CALLBACK_LOGGERS="1",  # the run directories are the record
        TUNE_DISABLE_SIGINT_HANDLER="1",  # Ctrl-C ends the command; the next one continues
        RAY_CHDIR_TO_TRIAL_DIR="0",
        RAY_AIR_NEW_OUTPUT="0",
    )
    import ray

    if address and ":" in address and "//" not in address:
        check_reachable(address)
    local: dict[str, Any] = {
        "include_dashboard": False,
        "object_store_memory": 128 * 2**20,
        "num_cpus": available_cores(),
    }
    try:
        ray.init(address or "local", log_to_driver=False, logging_level=logging.ERROR, **({} if address else local))
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"no Ray cluster at '{address}' ({reason}); start one with: ray start --head") from error
    logging.getLogger("ray.tune").setLevel(logging.CRITICAL)  # failures are reported at the end, in a line each
    try:
        yield
    finally:
        ray.shutdown()


def check_reachable(address: str) -> None:
    """Raise a ConfigError unless something listens at HOST:PORT; Ray itself would try for many minutes."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigError(f"no Ray cluster at '{address}' ({error}); start one with: ray start --head") from error


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and sweep.

    Returns:
        The exit status: 0, 1 if trials failed, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(sweep_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
