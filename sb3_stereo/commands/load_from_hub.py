"""Download a run from the Hugging Face Hub: `python -m sb3_stereo load_from_hub --repo-id OWNER/NAME`."""

import argparse
import sys

from sb3_stereo.commands.flags import Parser, add_repository_flags, add_run_flags, run_command
from sb3_stereo.console import command_line, print_line


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; the flags are the zoo's."""
    parser = Parser(
        prog=command_line("load_from_hub"),
        description="Download a trained agent that push_to_hub has uploaded, as the next run of the log folder.",
    )
    add_run_flags(parser)
    add_repository_flags(parser)
    parser.add_argument(
        "--trust", action="store_true", help="take a model without a checksum, too; the commands need --trust for it"
    )
    parser.add_argument(
        "--gym-packages", nargs="+", default=[], metavar="PACKAGE", help="packages that register the environment"
    )
    return parser


def load_command(args: argparse.Namespace) -> int:
    """Download, and say how to play the agent."""
    from sb3_stereo.runs.directory import import_packages, model_path, read_record
    from sb3_stereo.runs.models import is_whole
    from sb3_stereo.sharing import hub

    import_packages(args.gym_packages)
    repo_id = args.repo_id or hub.repository(args.algo, args.env, args.organization, args.repo_name)
    run = hub.fetch(repo_id, args.log_folder, args.trust)
    record = read_record(run)
    flags = ["--algo", record.algo, "--env", record.env_id, "-f", str(args.log_folder)]
    flags += ["--gym-packages", *args.gym_packages] if args.gym_packages else []
    flags += [] if is_whole(model_path(run, record.env_id)) else ["--trust"]
    print_line(f"Downloaded into {run}")
    print_line(f"Watch it with: {command_line('enjoy', *flags)}")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and download.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(load_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
