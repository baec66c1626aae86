"""Train an agent: `python train.py --algo ddpg`, or `sb3-stereo train --algo ddpg`."""

import argparse
import os
import random
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from sb3_stereo import runtime
from sb3_stereo.commands.flags import (
    INTERRUPTED,
    Parser,
    add_process_flags,
    add_run_flags,
    at_least,
    check_device,
    path,
    run_command,
)
from sb3_stereo.console import aligned, command_line
from sb3_stereo.errors import ConfigError

if TYPE_CHECKING:
    from sb3_stereo.config.schema import Config
    from sb3_stereo.training.options import Options, Result


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; the flags are the zoo's."""
    parser = Parser(prog=command_line("train"), description="Train an agent and evaluate it on the test poses.")
    add_run_flags(parser)
    parser.add_argument(
        "-n", "--n-timesteps", type=at_least(1, -1), default=-1, help="environment steps (default: the YAML's)"
    )
    parser.add_argument(
        "-i",
        "--trained-agent",
        type=path,
        metavar="ZIP",
        help="warm start from this model; pretrained: the one that ships",
    )
    parser.add_argument("--trust", action="store_true", help="accept a model that none of our runs has saved")
    parser.add_argument("--seed", type=at_least(0, -1), default=-1, help="random seed (default: a new one, printed)")
    parser.add_argument(
        "-conf", "--conf-file", type=path, help="YAML file with hyper-parameters (default: ours for the algorithm)"
    )
    parser.add_argument(
        "-params",
        "--hyperparams",
        nargs="+",
        metavar="KEY:VALUE",
        help="overrides, e.g. gamma:0.9 policy_kwargs.n_critics:1",
    )
    parser.add_argument("--env-kwargs", nargs="+", metavar="KEY:VALUE", help="arguments of the environment")
    parser.add_argument(
        "--eval-env-kwargs", nargs="+", metavar="KEY:VALUE", help="those that differ where the agent is evaluated"
    )
    parser.add_argument("--vec-env", choices=("dummy", "subproc"), default="dummy", help="VecEnv type")
    parser.add_argument(
        "--eval-freq",
        type=at_least(0, -1),
        default=0,
        help="steps between evaluations (default: the paper's steps; -1: only the end)",
    )
    parser.add_argument(
        "--eval-episodes",
        type=at_least(0),
        default=0,
        metavar="N",
        help="of the test poses, how many each evaluation plays (default: 0, all of them)",
    )
    parser.add_argument(
        "--n-eval-envs",
        type=at_least(1, -1),
        default=-1,
        help="parallel environments per evaluation, one process each (default: free cores, up to 4)",
    )
    parser.add_argument(
        "--save-freq",
        type=at_least(1, -1),
        default=1000,
        help="steps between saved models and snapshots (default: 1000; -1: none)",
    )
    parser.add_argument("--resume", type=path, metavar="RUN", help="resume an interrupted run with its own settings")
    parser.add_argument("-tb", "--tensorboard-log", type=path, help="TensorBoard folder (default: none)")
    parser.add_argument(
        "--track",
        nargs="?",
        const="wandb",
        choices=("wandb", "mlflow"),
        help="also log to Weights & Biases, or to MLflow",
    )
    parser.add_argument(
        "--wandb-project-name",
        default="sb3_stereo",
        metavar="NAME",
        help="the project, for MLflow the experiment (default: sb3_stereo)",
    )
    parser.add_argument("--wandb-entity", metavar="NAME", help="the user or team at Weights & Biases")
    parser.add_argument("-tags", "--wandb-tags", nargs="+", default=[], metavar="TAG", help="of the tracker's run")
    parser.add_argument("-P", "--progress", action="store_true", help="show the progress bar even without a terminal")
    parser.add_argument(
        "-optimize", "--optimize-hyperparameters", action="store_true", help=f"see {command_line('sweep')}"
    )
    add_process_flags(parser)
    return parser


def make_config(args: argparse.Namespace) -> "Config":
    """Return what a command learns."""
    from sb3_stereo.config.schema import load_config
    from sb3_stereo.config.values import parse_assignments

    params, env_kwargs, eval_env_kwargs = map(
        parse_assignments, (args.hyperparams, args.env_kwargs, args.eval_env_kwargs)
    )
    return load_config(args.algo, args.env, args.conf_file, params, env_kwargs, args.n_timesteps, eval_env_kwargs)


def make_options(args: argparse.Namespace) -> "Options":
    """Return how a command runs its training."""
    from sb3_stereo.training.options import Options

    return Options(
        seed=args.seed if args.seed >= 0 else random.SystemRandom().randrange(2**31),
        log_folder=args.log_folder,
        eval_freq=args.eval_freq,
        eval_episodes=args.eval_episodes,
        n_eval_envs=args.n_eval_envs if args.n_eval_envs > 0 else runtime.free_cores(),
        save_freq=args.save_freq,
        tensorboard_log=args.tensorboard_log,
        track=args.track,
        wandb_project_name=args.wandb_project_name,
        wandb_entity=args.wandb_entity,
        wandb_tags=tuple(args.wandb_tags),
        device=args.device,
        vec_env=args.vec_env,
        trained_agent=args.trained_agent,
        trust=args.trust,
        progress=args.progress or None,
        verbose=args.verbose,
    )


def train_command(args: argparse.Namespace) -> int:
    """Read the configuration, train, and say how it went."""
    runtime.tune_allocator()
    if args.optimize_hyperparameters:
        raise ConfigError(f"train makes one run; search with: {command_line('sweep', '--help')}")
    if args.resume:
        return resume_command(args)
    from sb3_stereo.runs.directory import import_packages
    from sb3_stereo.runs.pretrained import PRETRAINED, pretrained_model
    from sb3_stereo.training.trainer import train

    import_packages(args.gym_packages)
    config = make_config(args)
    if args.trained_agent == PRETRAINED:
        args.trained_agent = str(pretrained_model(config.algo, config.env_id))
    check_flags(args)
    options = make_options(args)
    with runtime.threads_for(args.num_threads) as n_threads:
        if args.verbose:
            print(f"Training {config.algo} on {config.env_id}, seed {options.seed}, {n_threads} threads, with")
            print(settings_table(config), flush=True)
        start = time.monotonic()
        result = train(config, options, vars(args))
        return report(result, time.monotonic() - start, args.verbose)


def settings_table(config: "Config") -> str:
    """Return a line per setting."""
    from sb3_stereo.config.schema import settings

    return aligned([[key, str(value)] for key, value in settings(config).items()], right=False)


def report(result: "Result", seconds: float, verbose: int) -> int:
    """Say how a training went and return the exit status."""
    from sb3_stereo.evaluation.scores import read_scores, score_table
    from sb3_stereo.runs.directory import BEST_MODEL, how_to_watch

    if verbose and result.evaluation is not None:
        print(f"\nEvaluations:\n{score_table(read_scores(result.run))}")
        print(f"The best one is {BEST_MODEL}: watch it with {how_to_watch(result.run)}\n")
    print(last_line(result, seconds))
    return INTERRUPTED if result.interrupted else 0


def resume_command(args: argparse.Namespace) -> int:
    """Go on with a run and say how it went, and in a line each what of it was damaged."""
    from sb3_stereo.config.modules import import_installed, import_packages
    from sb3_stereo.runs.directory import load_record, read_record
    from sb3_stereo.training.options import recorded_options
    from sb3_stereo.training.trainer import resume

    given = [name for name, value in vars(make_parser().parse_args([])).items() if getattr(args, name) != value]
    for name in set(given) - {"resume", "verbose", "gym_packages"}:
        raise ConfigError(f"--resume takes the run's own settings, got '{name}' too; leave it out")
    run = Path(args.resume)
    import_packages(args.gym_packages)
    import_installed(read_record(run).packages)
    recorded = load_record(run)[1]
    recorded_options(recorded)
    with runtime.threads_for(recorded.get("num_threads", -1)), warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: print(f"warning: {message}", file=sys.stderr)
        start = time.monotonic()
        return report(resume(run, args.verbose), time.monotonic() - start, args.verbose)


def check_flags(args: argparse.Namespace) -> None:
    """Raise a ConfigError for a flag whose value or extra is missing."""
    from importlib.util import find_spec

    check_device(args.device)
    if args.seed >= 2**32:
        raise ConfigError(f"--seed must be below {2**32}, got {args.seed}")
    if args.tensorboard_log and find_spec("tensorboard") is None:
        raise ConfigError("-tb needs TensorBoard; install it with: pip install 'sb3_stereo[tensorboard]'")
    if args.progress and find_spec("rich") is None:
        raise ConfigError("-P needs rich; install it with: pip install 'sb3_stereo[progress]'")


def last_line(result: "Result", seconds: float) -> str:
    """Return what a person wants to know at the end."""
    from sb3_stereo.console import duration
    from sb3_stereo.evaluation.callback import describe
    from sb3_stereo.runs.directory import how_to_resume

    took = duration(seconds)
    run = f"run: {os.path.relpath(result.run)}"
    if result.interrupted:
        after = f"after {result.n_timesteps} steps in {took}"
        saved = "the model is saved; " if result.model else ""
        return f"Interrupted by {result.interrupted} {after}; {saved}{how_to_resume(result.run)}"
    assert result.evaluation is not None  # every training that ends is scored
    return f"Done: {result.n_timesteps} steps in {took}; {describe(result.evaluation)}; {run}"


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and train.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(train_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
