"""Plot the learning curves of runs: `python -m sb3_stereo plot logs/ddpg/* -o curves.png`."""

import argparse
import sys
from pathlib import Path

from sb3_stereo.commands.flags import Parser, path, run_command
from sb3_stereo.console import command_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.curves import draw, group_runs, readable_runs

FORMATS = (".pdf", ".png", ".svg")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("plot"),
        description="Plot learning curves; runs that differ only in their seed share a curve.",
    )
    parser.add_argument("runs", type=path, metavar="RUN", nargs="+", help="run directories, e.g. logs/ddpg/*")
    parser.add_argument(
        "-o", "--output", type=path, default="curves.png", metavar="FILE", help="output image (default: curves.png)"
    )
    parser.add_argument("--labels", nargs="+", metavar="TEXT", help="names of the curves, in their order")
    return parser


def plot_command(args: argparse.Namespace) -> int:
    """Read the runs and draw them."""
    file = Path(args.output)
    if file.suffix not in FORMATS:
        raise ConfigError(f"cannot draw '{file}'; the name must end in {', '.join(FORMATS)}")
    runs, left_out = readable_runs([Path(run) for run in args.runs])
    if not runs:
        raise ConfigError("; ".join(left_out))
    groups = group_runs(runs)
    if args.labels and len(args.labels) != len(groups):
        found = ", ".join(f"'{group.label}'" for group in groups)
        raise ConfigError(f"{len(args.labels)} --labels for {len(groups)} curves, which are {found}; give one each")
    names = args.labels or [group.label for group in groups]
    try:
        draw(groups, file, names)
    except ModuleNotFoundError as error:
        raise ConfigError(f'drawing needs {error.name}; install it with: pip install "sb3_stereo[plots]"') from error
    print(f"Drew {', '.join(names)} into {file}")
    for reason in left_out:
        print(f"left out: {reason}", file=sys.stderr)
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and draw.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(plot_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
