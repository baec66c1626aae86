"""Speed-up of a sweep with more workers: the same trials with 1, 2 and 4 at a time, on a local Ray.

    python -m benchmarks.speed.scaling

prints the table and writes it to `benchmarks/SCALING.md` and `benchmarks/results/scaling.json`. It needs a quiet
machine with four cores.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from benchmarks import FOLDER, RESULTS
from sb3_stereo.runs.creation import versions

ENV_ID = "WamStereoReach-v0"
SWEEP: dict[str, Any] = {
    "env": ENV_ID,
    "n_timesteps": 200,
    "eval_freq": -1,
    "seeds": list(range(8)),
    "method": "grid",
    "metric": {"name": "eval/success_rate", "goal": "maximize"},
    "parameters": {
        "gamma": {"values": [0.7]},  # a sweep searches something; the trials are the seeds
        "learning_starts": {"value": 100},
        "env_kwargs.max_episode_steps": {"value": 10},
    },
}
TINY = {"learning_starts": {"value": 10}, "batch_size": {"value": 4}, "env_kwargs.max_episode_steps": {"value": 1}}
QUICK = {"n_timesteps": 20, "seeds": [0, 1], "parameters": {"gamma": {"values": [0.7]}, **TINY}}


def measure(sweep: Mapping[str, Any], workers: int) -> dict[str, float]:
    """Run a sweep from its start.

    Returns:
        Seconds of the whole command, and those from the first trial's first record to the last trial's model.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scaling.yml"
        file.write_text(yaml.safe_dump(dict(sweep)), encoding="utf-8")
        flags = ("--workers", str(workers), "-f", folder, "--device", "cpu")
        start = time.monotonic()
        subprocess.run([sys.executable, "-m", "sb3_stereo", "sweep", str(file), *flags], stdout=sys.stderr, check=True)
        seconds = time.monotonic() - start
        first = min(path.stat().st_mtime for path in Path(folder).rglob("command.txt"))
        last = max(path.stat().st_mtime for path in Path(folder).rglob(f"{ENV_ID}.zip"))
    return {"command": seconds, "trainings": last - first}


def report(result: Mapping[str, Any]) -> str:
    """`SCALING.md`."""
    lines = [
        "# Speed-up of a sweep",
        "",
        f"Written by `python -m benchmarks.speed.scaling`; do not edit. The same {result['n_trials']} trials of "
        f"{result['n_timesteps']} steps on {ENV_ID}, each with one thread, on a local Ray; without the time that Ray "
        "takes to start and end, and with it.",
        "",
        "| workers | training, s | speed-up | whole command, s | speed-up |",
        "| --- | --- | --- | --- | --- |",
    ]
    one = result["seconds"]["1"]
    for workers, seconds in result["seconds"].items():
        columns = [f"{seconds[key]:.0f} | {one[key] / seconds[key]:.2f}" for key in ("trainings", "command")]
        lines.append(f"| {workers} | {' | '.join(columns)} |")
    return "\n".join([*lines, "", f"On {result['machine']}, {result['load']}; {result['versions']}.", ""])


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed.scaling", description="Speed-up of a sweep.")
    parser.add_argument("--quick", action="store_true", help="two tiny trials, 1 and 2 workers; nothing is written")
    args = parser.parse_args(argv)
    sweep = SWEEP | (QUICK if args.quick else {})
    load = f"load {os.getloadavg()[0]:.1f} before"  # what a reader needs to know of a quiet machine
    result = {
        "seconds": {str(workers): measure(sweep, workers) for workers in ((1, 2) if args.quick else (1, 2, 4))},
        "n_trials": len(sweep["seeds"]),
        "n_timesteps": sweep["n_timesteps"],
        "load": load,
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}",
        "versions": ", ".join(f"{name} {found}" for name, found in versions().items()),
    }
    if not args.quick:
        (RESULTS / "scaling.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        (FOLDER / "SCALING.md").write_text(report(result), encoding="utf-8")
    print(report(result))


if __name__ == "__main__":
    main()
