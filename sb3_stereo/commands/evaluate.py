"""Evaluate a run on the test poses: `python -m sb3_stereo evaluate logs/ddpg/WamStereoReach-v1_1`."""

import argparse
import json
import math
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import command_line
from sb3_stereo.errors import ConfigError, setting_up

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from sb3_stereo.config.schema import Config

N_DISTURBED = 20  # of the test poses, in each of the disturbed worlds


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("evaluate"), description="Evaluate a trained agent, by default on the 100 fixed test poses."
    )
    agent = parser.add_mutually_exclusive_group(required=True)
    agent.add_argument(
        "run", nargs="?", type=path, metavar="RUN", help="run directory, e.g. logs/ddpg/WamStereoReach-v1_1"
    )
    agent.add_argument(
        "--pretrained",
        nargs="?",
        const=DEFAULT_ENV,
        metavar="ENV",
        help=f"the agent that ships with the package for an environment (default: {DEFAULT_ENV})",
    )
    add_model_flags(parser)
    parser.add_argument("--env", metavar="ID", help="play another environment than the run's, with its arguments")
    parser.add_argument("--env-kwargs", nargs="+", metavar="KEY:VALUE", help="arguments of the environment")
    parser.add_argument("--poses", type=at_least(0), default=0, metavar="N", help="use N random poses instead")
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="S", help="random seed of these poses (default: 0)"
    )
    parser.add_argument(
        "--n-envs",
        type=at_least(1, -1),
        default=-1,
        help="parallel environments, one process each (default: free cores, up to 4)",
    )
    parser.add_argument(
        "--disturbances",
        action="store_true",
        help="score it in changed worlds too: light, sensor, cameras, arm, look, clutter",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=path,
        metavar="FILE.csv",
        help="where their scores go, and a picture beside them (default: disturbances.csv in the run's directory)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_process_flags(parser)
    return parser


def evaluate_command(args: argparse.Namespace) -> int:
    """Load a run, evaluate it and print the result."""
    runtime.tune_allocator()
    from sb3_stereo.building.factory import VEC_ENVS, make_env
    from sb3_stereo.console import Bar
    from sb3_stereo.evaluation.callback import describe
    from sb3_stereo.evaluation.protocol import eval_initial_states, evaluate, random_initial_states
    from sb3_stereo.runs.pretrained import pretrained_run

    check_output(args)
    run = args.run or pretrained_run("ddpg", args.pretrained)
    config, path, model = load_agent(args, run)
    config = moved(config, model, args)
    initial_states = (
        random_initial_states(args.poses, args.seed)
        if args.poses
        else eval_initial_states(config.env_id, config.env_kwargs)
    )
    n_envs = args.n_envs if args.n_envs > 0 else runtime.free_cores()
    env_fn = make_env(config.env_id, config.env_kwargs, config.env_wrapper)
    if args.disturbances:
        return disturb(args, run, config, model, n_envs)
    bar = (
        Bar(len(initial_states), "pose")
        if args.verbose
        else Bar(len(initial_states), "pose", bar=False, interval=math.inf)
    )
    try:
        result = evaluate(
            model, env_fn, initial_states, n_envs, VEC_ENVS["subproc" if n_envs > 1 else "dummy"], bar.update
        )
    finally:
        bar.close()
    print(json.dumps(json_scores(result.scores())) if args.json else f"{path}: {describe(result)}")
    return 0


def moved(config: "Config", model: "BaseAlgorithm", args: argparse.Namespace) -> "Config":
    """The run's configuration with the environment that the flags choose.

    Raises:
        ConfigError: If the agent does not fit there.
    """
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.config.schema import check_env_id, check_env_kwargs
    from sb3_stereo.config.values import parse_assignments

    env_id = args.env or args.pretrained or config.env_id
    if env_id == config.env_id and args.env_kwargs is None:
        return config
    check_env_id(env_id)
    env_kwargs = check_env_kwargs(env_id, {**config.env_kwargs, **parse_assignments(args.env_kwargs)})
    changed = replace(config, env_id=env_id, env_kwargs=env_kwargs)
    with setting_up(env_id):
        env = make_env(env_id, env_kwargs, config.env_wrapper)()
    env.close()
    for what in ("observation_space", "action_space"):
        theirs, own = getattr(env, what), getattr(model, what)
        if theirs != own:
            name = what.replace("_", " ")
            raise ConfigError(f"the {name} of {env_id} is {theirs}, and the agent's {own}; choose another environment")
    return changed


def check_output(args: argparse.Namespace) -> None:
    """Raise a ConfigError if there is nothing to write, or a picture would take the place of the scores."""
    if args.output is None:
        return
    if not args.disturbances:
        raise ConfigError("-o is where the scores of --disturbances go; add --disturbances, or leave -o out")
    if Path(args.output).suffix != ".csv":
        raise ConfigError(f"-o is '{args.output}'; give a file that ends in .csv, the picture goes beside it")


def disturb(args: argparse.Namespace, run: Path, config: "Config", model: "BaseAlgorithm", n_envs: int) -> int:
    """Score the agent in all worlds of the suite; print a table and write it with a picture."""
    from sb3_stereo.console import Bar
    from sb3_stereo.evaluation import disturbances
    from sb3_stereo.evaluation.protocol import eval_initial_states, random_initial_states

    if args.poses:
        initial_states = random_initial_states(args.poses, args.seed)
    else:
        initial_states = eval_initial_states(config.env_id, config.env_kwargs)[:N_DISTURBED]
    output = Path(args.output or (Path(run) / "disturbances.csv" if args.run else "disturbances.csv"))
    n_worlds = sum(1 for _ in disturbances.worlds(config))
    bar = Bar(n_worlds, "world") if args.verbose else Bar(n_worlds, "world", bar=False, interval=math.inf)
    try:
        scores = disturbances.score_disturbances(model, config, initial_states, n_envs, progress=bar.update)
    finally:
        bar.close()
    print(json.dumps([json_scores(asdict(score)) for score in scores]) if args.json else disturbances.table(scores))
    disturbances.write_scores(output, scores)
    picture = output.with_suffix(".png")
    disturbances.draw({Path(run).name: scores}, picture)
    if not args.json:
        print(f"written: {output}, {picture}")
    return 0


def json_scores(scores: dict[str, Any]) -> dict[str, Any]:
    """Return the scores with null for NaN, which JSON does not know."""
    nan = {key for key, value in scores.items() if isinstance(value, float) and math.isnan(value)}
    return {key: None if key in nan else value for key, value in scores.items()}


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and evaluate.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(evaluate_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
