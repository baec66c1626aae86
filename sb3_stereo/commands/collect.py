"""Record an agent's episodes for Minari or LeRobot: `python -m sb3_stereo collect RUN --dataset wam/reach-v0`."""

import argparse
import sys
from contextlib import closing

from sb3_stereo import runtime
from sb3_stereo.commands.flags import (
    Parser,
    add_dataset_flags,
    add_model_flags,
    add_process_flags,
    at_least,
    load_agent,
    path,
    run_command,
)
from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import Bar, command_line, print_line


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("collect"),
        description="Play an agent and record its episodes as a dataset of Minari (images, actions, rewards, infos) or "
        "LeRobot (the cameras' pictures, actions, rewards, the task in words).",
    )
    agent = parser.add_mutually_exclusive_group()
    agent.add_argument(
        "run", nargs="?", type=path, metavar="RUN", help="run directory of the agent (default: the one that ships)"
    )
    agent.add_argument(
        "--pretrained",
        nargs="?",
        const=DEFAULT_ENV,
        default=DEFAULT_ENV,
        metavar="ENV",
        help=f"the agent that ships with the package for an environment (default: {DEFAULT_ENV})",
    )
    add_model_flags(parser)
    add_dataset_flags(parser, required=True)
    parser.add_argument("--n-episodes", type=at_least(1), default=100, metavar="N", help="episodes (default: 100)")
    parser.add_argument("--seed", type=at_least(0), default=0, help="random seed of the first episode (default: 0)")
    parser.add_argument("--stochastic", action="store_true", help="stochastic actions")
    add_process_flags(parser)
    return parser


def collect_command(args: argparse.Namespace) -> int:
    """Load the agent, play it and write the dataset."""
    runtime.tune_allocator()
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.config.components import Component
    from sb3_stereo.runs.pretrained import pretrained_run
    from sb3_stereo.sharing.formats import open_dataset
    from sb3_stereo.sharing.recording import collect

    config, _, model = load_agent(args, args.run or pretrained_run("ddpg", args.pretrained))
    with closing(open_dataset(args.format, args.dataset, config.algo.upper(), args.author)) as writer:
        env_id = config.env_id if args.run else args.pretrained
        env_fn = make_env(env_id, config.env_kwargs, (Component(writer.recorder), *config.env_wrapper))
        with closing(env_fn()) as env, closing(Bar(args.n_episodes, "episode")) as bar:
            collect(model, env, writer, args.n_episodes, args.seed, not args.stochastic, bar.update)
    print_line(f"{writer.n_episodes} episodes in the dataset {args.dataset}, {writer.n_successes} reached the target")
    print_line(f"Load it in Python with: {writer.how_to_load}")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and record.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(collect_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
