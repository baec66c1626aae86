"""Two agents that pick up one after the other, scored on the whole task; see docs/pick.md.

    python -m benchmarks.analysis.switched REACH_RUN GRASP_RUN

The runs are of `WamStereoPick-v0` with composite "markers", one of phase "reach", one of phase "grasp". A third run,
`--alone`, of the whole task, is scored on the same episodes.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from benchmarks.analysis.rollouts import Policy, play
from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.flags import Parser, run_command
from sb3_stereo.config.schema import Config
from sb3_stereo.console import print_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.policies.switched import SwitchedAgent
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model


def loaded(run: str, phase: str | None, best: bool) -> tuple[Config, Any]:
    """A run's configuration and its agent.

    Raises:
        ConfigError: If the run is of another phase, or its observations do not show the markers.
    """
    config, _ = load_record(run)
    found = config.env_kwargs.get("phase"), config.env_kwargs.get("composite")
    if found != (phase, "markers"):
        wanted = "composite:markers" + (f" phase:{phase}" if phase else "")
        raise ConfigError(
            f"'{run}' has phase {found[0]!r} and composite {found[1]!r}; train it with --env-kwargs {wanted}"
        )
    return config, load_model(config, Path(model_path(run, config.env_id, best)))


def acting(agent: Any) -> Policy:
    """The policy of an agent's deterministic actions."""

    def act(observation: Any, info: Mapping[str, Any]) -> Any:
        return agent.predict(observation, deterministic=True)[0]

    return act


def switched_command(args: argparse.Namespace) -> int:
    """Load the agents and score them."""
    config, grasper = loaded(args.grasper, "grasp", args.load_best)
    agents = {"switched": SwitchedAgent(loaded(args.reacher, "reach", args.load_best)[1], grasper)}
    if args.alone:
        agents["one agent"] = loaded(args.alone, None, args.load_best)[1]
    kwargs = {name: value for name, value in config.env_kwargs.items() if name != "phase"}
    with closing(make_env(config.env_id, kwargs, config.env_wrapper)()) as env:
        for name, agent in agents.items():
            score = play(env, random_initial_states(args.episodes, args.seed), acting(agent))
            steps = f", {score.mean_steps_success:.1f} steps each" if score.success.any() else ""
            print_line(f"{name}: {score.success.sum()} of {score.n_poses} lifted{steps}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = Parser(prog="python -m benchmarks.analysis.switched", description=__doc__.splitlines()[0])
    parser.add_argument("reacher", metavar="REACH_RUN", help="directory of the run of phase reach")
    parser.add_argument("grasper", metavar="GRASP_RUN", help="directory of the run of phase grasp")
    parser.add_argument("--alone", metavar="RUN", help="directory of a run of the whole task, to compare with")
    parser.add_argument("--load-best", action="store_true", help="the best models instead of the last ones")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="default: 100")
    parser.add_argument("--seed", type=int, default=0, help="of the initial states (default: 0, those of `evaluate`)")
    return run_command(switched_command, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
