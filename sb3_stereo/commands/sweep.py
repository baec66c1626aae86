"""Sweep over hyper-parameters: `python -m sb3_stereo sweep hyperparams/sweeps/ddpg_gamma.yml`."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from sb3_stereo.commands.flags import Parser, add_process_flags, run_command
from sb3_stereo.console import command_line, print_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.tuning.cluster import add_cluster_flags, check_cluster_flags, connected

if TYPE_CHECKING:
    from sb3_stereo.tuning.config import Sweep


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("sweep"), description="Run a hyper-parameter sweep, described in a YAML file, on Ray Tune."
    )
    parser.add_argument("file", metavar="FILE", help="the sweep, e.g. hyperparams/sweeps/ddpg_gamma.yml")
    parser.add_argument("-f", "--log-folder", "--folder", default="logs", help="log folder (default: logs)")
    add_cluster_flags(parser)
    parser.add_argument(
        "--save-freq", type=int, default=1000, help="steps between a trial's snapshots (default: 1000; -1: none)"
    )
    parser.add_argument("--report", action="store_true", help="report the results so far without training")
    add_process_flags(parser, num_threads=1)
    return parser


def sweep_command(args: argparse.Namespace) -> int:
    """Run what is missing of a sweep and report it."""
    from sb3_stereo.runs.directory import import_packages
    from sb3_stereo.tuning.config import load_sweep
    from sb3_stereo.tuning.records import claim, is_done
    from sb3_stereo.tuning.report import tell_failures, write_report

    import_packages(args.gym_packages)
    sweep = load_sweep(args.file)
    check_flags(args, sweep)
    folder = Path(args.log_folder).absolute() / "sweeps" / Path(args.file).stem
    claim(sweep, folder)
    if sweep.unused:
        print(f"Not used: {', '.join(sweep.unused)}")
    failures = [] if args.report or is_done(sweep, folder) else run_sweep(args, sweep, folder)
    print(write_report(sweep, folder))
    return tell_failures(failures)


def check_flags(args: argparse.Namespace, sweep: "Sweep") -> None:
    """Raise a ConfigError for flags that cannot be used."""
    check_cluster_flags(args)
    if args.device.startswith("cuda") and sweep.resources.gpu == 0:
        raise ConfigError(f"--device {args.device} needs a GPU per trial; add it, as in resources: {{gpu: 0.25}}")


def run_sweep(args: argparse.Namespace, sweep: "Sweep", folder: Path) -> list[str]:
    """Run what is missing of a sweep, and return what failed."""
    if args.verbose:
        print_line("Starting Ray; the first scores come with the trials' first evaluations")
    with connected(args.address):
        from sb3_stereo.tuning.search import Job, fit_sweep

        packages, command = tuple(args.gym_packages), tuple(sys.orig_argv)
        job = Job(sweep, folder, args.device, args.num_threads, args.save_freq, packages, command)
        return fit_sweep(job, args.workers, args.verbose)


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and sweep.

    Returns:
        The exit status: 0, 1 if trials failed, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(sweep_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
