"""Upload a run to the Hugging Face Hub: `python -m sb3_stereo push_to_hub RUN --repo-id OWNER/NAME`."""

import argparse
import sys
import tempfile
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from sb3_stereo import runtime
from sb3_stereo.commands.flags import (
    Parser,
    add_model_flags,
    add_process_flags,
    add_repository_flags,
    add_run_flags,
    at_least,
    load_agent,
    path,
    run_command,
)
from sb3_stereo.console import Bar, command_line, print_line
from sb3_stereo.errors import ConfigError, setting_up

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from sb3_stereo.config.schema import Config
    from sb3_stereo.evaluation.protocol import Evaluation


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; the flags are the zoo's."""
    parser = Parser(
        prog=command_line("push_to_hub"),
        description="Evaluate and film a trained agent, and upload it to the Hugging Face Hub with its settings, its "
        "scores and a model card.",
    )
    parser.add_argument(
        "run", nargs="?", type=path, metavar="RUN", help="run directory (default: by --algo, --env, -f and --exp-id)"
    )
    add_run_flags(parser)
    parser.add_argument("--exp-id", type=at_least(0), default=0, help="number of the run (default: 0, the latest)")
    add_model_flags(parser)
    add_repository_flags(parser)
    parser.add_argument("-m", "--commit-message", default="Add a trained agent", help="message of the commit")
    parser.add_argument("--private", action="store_true", help="nobody else sees a repository that is new")
    parser.add_argument("--no-render", action="store_true", help="no video")
    parser.add_argument("--n-episodes", type=at_least(1), default=3, help="episodes of the video (default: 3)")
    add_process_flags(parser)
    return parser


def push_command(args: argparse.Namespace) -> int:
    """Evaluate, film, write the files and upload them."""
    runtime.tune_allocator()
    from sb3_stereo.runs.directory import find_run
    from sb3_stereo.sharing import hub

    run = Path(args.run) if args.run else find_run(args.log_folder, args.algo, args.env, args.exp_id)
    config, file, model = load_agent(args, run)
    repo_id = args.repo_id or hub.repository(config.algo, config.env_id, args.organization, args.repo_name)
    hub.check_login(repo_id)
    print_line(f"Evaluating {file}")
    result = evaluated(config, model)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if not args.no_render:
            film_into(folder / hub.REPLAY, config, model, args.n_episodes)
        with setting_up("the repository's files"):
            hub.pack(folder, run, config, file, result, repo_id)
        url = hub.push(folder, repo_id, args.commit_message, args.private)
    print_line(f"Uploaded to {url}")
    return 0


def evaluated(config: "Config", model: "BaseAlgorithm") -> "Evaluation":
    """Return the model's scores on the test poses."""
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.evaluation.protocol import eval_initial_states, evaluate

    initial_states = eval_initial_states(config.env_id, config.env_kwargs)
    env_fn = make_env(config.env_id, config.env_kwargs, config.env_wrapper)
    with closing(Bar(len(initial_states), "pose")) as bar:
        return evaluate(model, env_fn, initial_states, progress=bar.update)


def film_into(file: Path, config: "Config", model: "BaseAlgorithm", n_episodes: int) -> None:
    """Film the agent, unless its environment or this machine cannot."""
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.viz.film import film

    with closing(make_env(config.env_id, config.env_kwargs, config.env_wrapper)()) as env:
        if not hasattr(env.unwrapped, "draw"):
            print_line(f"No video: {config.env_id} cannot be filmed")
            return
        print_line("Filming")
        try:
            film(model, env, file, n_episodes)
        except ConfigError as error:
            print_line(f"No video: {error}")


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and upload.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(push_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
