"""Write a page about a run or a sweep: `python -m sb3_stereo report logs/ddpg/WamStereoReach-v1_1`."""

import argparse
import sys
from pathlib import Path

from sb3_stereo import runtime
from sb3_stereo.commands.flags import (
    Parser,
    add_model_flags,
    add_process_flags,
    at_least,
    load_agent,
    path,
    run_command,
)
from sb3_stereo.console import command_line, print_line
from sb3_stereo.errors import ConfigError


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("report"),
        description="Write one HTML file about a run (film, curves, scores, settings) or about a sweep.",
    )
    parser.add_argument("run", type=path, metavar="RUN", help="directory of a run, or of a sweep (logs/sweeps/NAME)")
    parser.add_argument(
        "-o", "--output", type=path, metavar="FILE.html", help="the file (default: report.html in the directory)"
    )
    parser.add_argument("--n-episodes", type=at_least(0), default=3, help="of the film; 0: no film (default: 3)")
    add_model_flags(parser)
    add_process_flags(parser)
    return parser


def report_command(args: argparse.Namespace) -> int:
    """Write the page."""
    runtime.tune_allocator()
    from sb3_stereo.evaluation.html_report import run_report, sweep_report, write_report

    run = Path(args.run)
    file = Path(args.output or run / "report.html")
    if file.suffix != ".html":
        raise ConfigError(f"-o is '{file}'; give a file that ends in .html")
    if (run / "sweep.yml").is_file():
        write_report(sweep_report(run), file)
    else:
        _, _, model = load_agent(args, run)
        write_report(run_report(run, model, args.n_episodes), file)
    print_line(f"Written: {file}")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and write.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(report_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
