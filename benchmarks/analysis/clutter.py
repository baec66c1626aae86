"""Reaching among clutter: what the cameras see of it, and how agents and controllers do.

    python -m benchmarks.analysis.clutter --baselines
    python -m benchmarks.analysis.clutter RUN --name NAME [--checkpoint STEPS] [--poses N]

The first counts in which views both markers are seen, and scores the Jacobian controller, which knows the state, and
random actions. The second scores a run's agent, in the views that it was trained with, and, if it was trained with lost
cameras, without each of them. Both are recorded in `benchmarks/results/clutter*.csv`, from which
`benchmarks/CLUTTER.md` is written; without arguments only that is done.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import benchmarks
from benchmarks.analysis.baselines import Line, read_lines, write_lines
from benchmarks.analysis.jacobian import JacobianController
from benchmarks.analysis.rollouts import Policy, play, random_actions
from benchmarks.tables.row_tables import line_of
from sb3_stereo.building.factory import VEC_ENVS, make_env
from sb3_stereo.commands.flags import Parser, at_least, run_command
from sb3_stereo.console import print_line
from sb3_stereo.envs.cameras import RIGS
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import Evaluation, eval_initial_states, evaluate
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model

ENV_ID = "WamStereoReachClutter-v0"
CLUTTERS: dict[str, Any] = {"none": None, "not solid": {"solid": False}, "solid": "default"}
N_POSES = 40  # of the test poses
N_SEEN = 200  # episodes, of whose first pictures the views are counted
LABELS = {
    "jacobian": "Jacobian controller, which knows the state",
    "random": "random actions",
    "v1_ours_ddpg": "ours, clean images, trained without clutter",
    "v1_robust_ddpg": "ours, augmented images, trained without clutter",
    "clutter_volume": "four cameras as a volume, trained in clutter with lost cameras",
}
COMMAND = "`python -m benchmarks.analysis.clutter`"
TEXT = f"""# Reaching among clutter

`{ENV_ID}` has things around the arm, before it and moving past
([the environment](../docs/environment.md#clutter-more-cameras-and-lost-ones)). A row is one
agent, and a cell its success in % over the first of the test poses; in brackets are the steps, failures counted as 30.
This page is written by {COMMAND} from `benchmarks/results/clutter.csv` and
`clutter_views.csv`.
"""


ENCODERS = """How an encoder treats four views, without a policy (`python -m benchmarks.analysis.volume`, one seed). All
are trained alike on 1 500 transitions of random actions in clutter, one camera lost in half of the episodes. The
numbers are median errors in px of the offset between the markers that a head reads from other episodes' images, over
all views, the lost one too:
"""


def record(name: str = "clutter") -> Path:
    """The file of the scores, or of the views."""
    return benchmarks.RESULTS / f"{name}.csv"


def seen_by(cameras: str, clutter: Any) -> Line:
    """Shares of random episodes in whose first pictures both markers are seen: by each view, by all and by two."""
    with closing(gym.make(ENV_ID, cameras=cameras, clutter=clutter)) as env:
        seen = np.array([~np.isnan(env.reset(seed=seed)[1]["pixel_distances"]) for seed in range(N_SEEN)])
    shares = dict(zip(RIGS[cameras], seen.mean(axis=0), strict=True))
    shares |= {"all": seen.all(axis=1).mean(), "two or more": (seen.sum(axis=1) >= 2).mean()}
    return {name: f"{share:.4g}" for name, share in shares.items()}


def score_line(agent: Mapping[str, str], clutter: str, lost: str, score: Evaluation) -> Line:
    """A line of the record."""
    numbers = {name: f"{getattr(score, name):.6g}" for name in ("success_rate", "mean_steps_capped", "within_5cm")}
    return {**agent, "clutter": clutter, "lost": lost, **numbers, "n_poses": str(score.n_poses)}


def score_baselines() -> list[Line]:
    """Of the controller with two and with four cameras, and of random actions."""
    makers: dict[str, Callable[[Any], Policy]] = {
        "jacobian": lambda env: JacobianController(env.unwrapped),
        "random": lambda env: random_actions(env, seed=0),
    }
    lines = []
    for name, cameras in (("jacobian", "stereo"), ("jacobian", "four"), ("random", "stereo")):
        for clutter, spec in CLUTTERS.items():
            with closing(gym.make(ENV_ID, cameras=cameras, clutter=spec)) as env:
                score = play(env, eval_initial_states(ENV_ID)[:N_POSES], makers[name](env))
            agent = {"row": name, "seed": "0", "timesteps": "0", "cameras": str(len(RIGS[cameras]))}
            lines.append(score_line(agent, clutter, "", score))
            print_line(f"{name}, {cameras}, {clutter}: {100 * score.success_rate:.0f} %")
    return lines


def score_run(run: Path, name: str, checkpoint: int | None, n_poses: int, n_envs: int) -> list[Line]:
    """Score a run's agent in all clutters; in the first and the last with each camera lost, if it was trained so."""
    config, arguments = load_record(run)
    model = load_model(config, model_path(run, config.env_id, checkpoint=checkpoint))
    kwargs = {key: value for key, value in config.env_kwargs.items() if key != "camera_loss"}
    names = [camera if isinstance(camera, str) else camera["name"] for camera in kwargs.get("cameras", RIGS["stereo"])]
    agent = {"row": name, "seed": str(arguments["seed"]), "timesteps": str(checkpoint or config.n_timesteps)}
    lines, trained_so = [], bool(config.env_kwargs.get("camera_loss"))
    for clutter, spec in CLUTTERS.items():
        for lost in ("", *(names if trained_so and clutter != "not solid" else ())):
            env_fn = make_env(ENV_ID, {**kwargs, "clutter": spec, "lost_camera": lost or None}, config.env_wrapper)
            states = eval_initial_states(ENV_ID)[:n_poses]
            score = evaluate(model, env_fn, states, n_envs, VEC_ENVS["subproc" if n_envs > 1 else "dummy"])
            lines.append(score_line(agent | {"cameras": str(len(names))}, clutter, lost, score))
            print_line(f"{clutter}, lost {lost or 'none'}: {100 * score.success_rate:.0f} %")
    return lines


def add_lines(lines: Sequence[Line]) -> None:
    """Put lines into the record, in place of those of an earlier scoring."""
    agents = {(line["row"], line["seed"], line["cameras"]) for line in lines}
    others = [one for one in read_lines(record()) if (one["row"], one["seed"], one["cameras"]) not in agents]
    order = list(LABELS)
    write_lines(record(), sorted([*others, *lines], key=lambda line: (order.index(line["row"]), int(line["seed"]))))


def page(scores: Sequence[Line], views: Sequence[Line], encoders: Sequence[Line] = ()) -> str:
    """The page: a row per agent, and what its lost cameras cost; then the views, and encoders without a policy."""
    agents: dict[tuple[str, ...], dict[tuple[str, str], Line]] = {}
    for line in scores:
        agent = line["row"], line["seed"], line["timesteps"], line["cameras"]
        agents.setdefault(agent, {})[line["clutter"], line["lost"]] = line
    head = ["agent", "steps", "cameras", "poses", *CLUTTERS, "none, each camera lost", "solid, each camera lost"]
    rows = []
    for (row, _, steps, cameras), cells in agents.items():
        plain = [_cell(cells[clutter, ""]) for clutter in CLUTTERS]
        lost = [_lost_cell(cells, clutter) for clutter in ("none", "solid")]
        rows.append([LABELS[row], steps, cameras, cells["none", ""]["n_poses"], *plain, *lost])
    seen_head = ["clutter", *list(views[0])[1:]] if views else []
    seen = [[line["clutter"], *(f"{100 * float(share):.1f}" for share in list(line.values())[1:])] for line in views]
    about = f"\nShare in % of {N_SEEN} random episodes in whose first pictures a view shows both markers:\n\n"
    text = f"{TEXT}\n{_table(head, rows)}\n{about}{_table(seen_head, seen)}\n"
    if encoders:
        lost = [f"{name} lost" for name in list(encoders[0])[2:]]
        rows = [[f"{float(v):.1f}" if key != "encoder" else v for key, v in line.items()] for line in encoders]
        text += f"\n{ENCODERS}\n{_table(['encoder', 'all cameras', *lost], rows)}\n"
    return text


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(map(line_of, [head, ["---"] * len(head), *rows]))


def _cell(line: Line) -> str:
    return f"{100 * float(line['success_rate']):.0f} ({float(line['mean_steps_capped']):.1f})"


def _lost_cell(cells: Mapping[tuple[str, str], Line], clutter: str) -> str:
    lost = {name: line for (known, name), line in cells.items() if known == clutter and name}
    return ", ".join(f"{name} {100 * float(line['success_rate']):.0f}" for name, line in lost.items())


def write_page() -> None:
    """Write the page from the records."""
    text = page(*(read_lines(record(name)) for name in ("clutter", "clutter_views", "volume")))
    (benchmarks.RESULTS.parent / "CLUTTER.md").write_text(text, encoding="utf-8")


def clutter_command(args: argparse.Namespace) -> int:
    """Score what is asked for, and write the page."""
    if args.baselines:
        views = [{"clutter": name} | seen_by("four", spec) for name, spec in CLUTTERS.items() if name != "not solid"]
        write_lines(record("clutter_views"), views)
        add_lines(score_baselines())
    if args.run is not None:
        if args.name not in LABELS:
            raise ConfigError(f"unknown name {args.name!r}; the table's agents are {', '.join(LABELS)}")
        add_lines(score_run(Path(args.run), args.name, args.checkpoint, args.poses, args.n_envs))
    write_page()
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = Parser(prog="python -m benchmarks.analysis.clutter", description=__doc__.splitlines()[0])
    parser.add_argument("run", nargs="?", metavar="RUN", help="the run's directory")
    parser.add_argument("--name", help=f"what it is a run of: {', '.join(LABELS)}")
    parser.add_argument("--checkpoint", type=at_least(1), metavar="STEPS", help="its checkpoint after so many steps")
    parser.add_argument("--poses", type=at_least(1), default=N_POSES, help=f"test poses (default: {N_POSES})")
    parser.add_argument("--baselines", action="store_true", help="count views, score the controller and random actions")
    parser.add_argument("--n-envs", type=at_least(1), default=1, help="parallel environments (default: 1)")
    return run_command(clutter_command, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
