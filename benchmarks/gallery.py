"""Film the agents that ship, and write the gallery's page: `python -m benchmarks.gallery`.

A clip per agent goes into `docs/images/gallery/`, and a section about it into `docs/gallery.md`, between its two marks.
"""

import argparse
import json
import re
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym

from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.enjoy import play
from sb3_stereo.console import print_line
from sb3_stereo.pretrained import FOLDER
from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.files import write
from sb3_stereo.runs.pretrained import load_pretrained, pretrained_names, pretrained_run
from sb3_stereo.viz.film import N_PARTS, Filmed, Gif

PAGE = Path(__file__).parents[1] / "docs" / "gallery.md"
CLIPS = PAGE.parent / "images" / "gallery"
START, END = "<!-- clips, written by python -m benchmarks.gallery -->", "<!-- end of clips -->"
SCALE = 0.5  # 560 px wide
LENGTHS = (4, 5, 6)  # [steps] of an episode that shows something and is a small file
MAX_SEED = 200
TASKS = {
    "WamStereoReach": "The Barrett WAM reaches a fixed target",
    "WamStereoReachRandom": "The WAM reaches a target that is elsewhere in every episode",
    "KukaStereoReach": "The Kuka iiwa reaches a fixed target",
    "PandaStereoReach": "The Franka Panda reaches a fixed target",
}


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gallery", description="Film the agents that ship.")
    parser.add_argument("envs", nargs="*", metavar="ENV", help="film those alone (default: all that ship)")
    args = parser.parse_args(argv)
    shipped = sorted(pretrained_names(), key=lambda agent: (agent[1].endswith("-v0"), agent))  # the old task comes last
    for algo, env_id in shipped:
        if not args.envs or env_id in args.envs:
            file = film_agent(algo, env_id)
            print_line(f"{file}, {file.stat().st_size / 1e3:.0f} kB")
    sections = "\n\n".join(section(algo, env_id) for algo, env_id in shipped)
    write(PAGE, with_sections(PAGE.read_text(encoding="utf-8"), sections).encode())


def film_agent(algo: str, env_id: str) -> Path:
    """Film an episode of the agent that ships for an environment."""
    config = load_record(pretrained_run(algo, env_id))[0].evaluated
    model = load_pretrained(env_id, algo, "cpu")
    CLIPS.mkdir(parents=True, exist_ok=True)
    file = CLIPS / f"{env_id}.gif"
    with closing(make_env(env_id, config.env_kwargs, config.env_wrapper)()) as env:
        seed = fitting_seed(model, env)
        writer = Gif(file, N_PARTS * env.metadata["render_fps"], SCALE)
        play(model, Filmed(env, writer), float("inf"), seed, n_episodes=1)
        writer.close()
    return file


def fitting_seed(model: Any, env: gym.Env[Any, Any]) -> int:
    """Return the first seed whose episode reaches the target in a number of steps that is good to watch."""
    for seed in range(MAX_SEED):
        ((success, steps),) = play(model, env, float("inf"), seed, n_episodes=1)
        if success and steps in LENGTHS:
            return seed
    return 0


def section(algo: str, env_id: str) -> str:
    """Return what the page says of an agent: its clip, its scores, the command that plays it."""
    scores = json.loads((FOLDER / algo / f"{env_id}_1" / "score.json").read_text(encoding="utf-8"))
    rho = gym.spec(env_id).kwargs.get("rho", 10.0)
    task = TASKS.get(env_id.rpartition("-")[0], env_id)
    success, steps, n_poses = scores["success_rate"], scores["mean_steps_success"], scores["n_poses"]
    text = (
        f"{task}, as close as {rho:g} px in the images. The agent reaches it from {100 * success:.0f} % of {n_poses} "
        f"poses, in {steps:.1f} steps, {100 * scores['median_distance_success']:.1f} cm from it in the median."
    )
    alt = f"An episode of {algo.upper()} on {env_id}: the scene, both views, the network's input, the torques"
    command = f"$ python enjoy.py --pretrained --algo {algo} --env {env_id} --video film.mp4"
    picture = f"![{alt}](images/gallery/{env_id}.gif)"
    return f"## {env_id}\n\n{text}\n\n{picture}\n\n```console\n{command}\n```"


def with_sections(page: str, sections: str) -> str:
    """Return the page with other sections between its marks."""
    pattern = re.compile(f"(?<={re.escape(START)}\n).*?(?={re.escape(END)})", re.DOTALL)
    changed, n = pattern.subn(lambda _: f"\n{sections}\n\n", page)
    if n != 1:
        raise ValueError(f"the page must have '{START}' and '{END}' once each")
    return changed


if __name__ == "__main__":
    main()
