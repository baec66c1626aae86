"""Speed of the environment and of the algorithms against the alternatives.

    python -m benchmarks.speed

times every candidate in every round of one run, prints the ratios of the medians and the parts of a step, and writes
`benchmarks/SPEED.md` and `benchmarks/results/speed.json`. Candidates that are not installed
(`pip install -e ".[peers]"`) are left out.
"""

import argparse
import json
import math
import os
import platform
from collections.abc import Sequence
from typing import Any

from benchmarks import FOLDER, RESULTS
from benchmarks.speed.environments import measure_envs, measure_memory, measure_scaling
from benchmarks.speed.timing import library_lines_to_stderr
from benchmarks.speed.trainings import measure_training
from benchmarks.speed.updates import measure_updates
from sb3_stereo.runs.creation import versions

Numbers = dict[str, float]

RATIOS = {  # what each is, and what we want of it
    "env_vs_panda_gym": ("environment steps per second, against panda-gym", "≥ 15"),
    "env_with_floor_vs_panda_gym": ("the same with a drawn floor", "≥ 15"),
    "env_vs_fetch": ("environment steps per second, against FetchReach", "≥ 3"),
    "step_vs_bare": ("time of an environment step, against its bare simulation and pictures", "≤ 1.3"),
    "overhead_fraction": ("share of a step outside these", "≤ 0.15"),
    "env_scaling_2": ("environment steps in two processes, against twice one", "≥ 0.8"),
    "env_scaling_4": ("in four, against four times one", ""),
    "ddpg_update_vs_sb3": ("gradient steps per second of DDPG, against SB3", "≥ 3.5"),
    "dqn_update_vs_sb3": ("gradient steps per second of DQN, against SB3", "≥ 2.5"),
    "dqn_nature_update_vs_sbx": ("the same with the network of Mnih et al., against sbx", ""),
    "ddpg_predict_vs_sb3": ("predictions per second of DDPG, against SB3", ""),
    "dqn_predict_vs_sb3": ("predictions per second of DQN, against SB3", ""),
}


def ratios(envs: Numbers, rates: Numbers, updates: Numbers, predictions: Numbers) -> dict[str, float | None]:
    """The claims; None where a peer is missing."""

    def over(table: Numbers, peer: str, own: str) -> float | None:
        return round(table[peer] / table[own], 2) if peer in table else None

    return {
        "env_vs_panda_gym": over(envs, "panda-gym", "ours"),
        "env_with_floor_vs_panda_gym": over(envs, "panda-gym", "ours, with a floor"),
        "env_vs_fetch": over(envs, "FetchReach", "ours"),
        "step_vs_bare": over(envs, "ours", "ours, bare"),
        "overhead_fraction": round(1 - envs["ours, bare"] / envs["ours"], 3),
        "env_scaling_2": round(rates["2"] / (2 * rates["1"]), 2),
        "env_scaling_4": round(rates["4"] / (4 * rates["1"]), 2),
        "ddpg_update_vs_sb3": over(updates, "ddpg, sb3", "ddpg, ours"),
        "dqn_update_vs_sb3": over(updates, "dqn, sb3", "dqn, ours"),
        "dqn_nature_update_vs_sbx": over(updates, "dqn_nature, sbx", "dqn_nature, ours"),
        "ddpg_predict_vs_sb3": over(predictions, "ddpg, sb3", "ddpg, ours"),
        "dqn_predict_vs_sb3": over(predictions, "dqn, sb3", "dqn, ours"),
    }


def measure(rounds: int, threads: int) -> dict[str, Any]:
    """The record: everything in one run."""
    envs, parts = measure_envs(rounds)
    rates = measure_scaling(max(rounds // 3, 1))
    updates, predictions = measure_updates(rounds, threads)
    training, training_memory = measure_training(rounds, threads)
    memory = {"stepping the environment": measure_memory(), "training, replay buffer full": training_memory}
    return {
        "ratios": ratios(envs, rates, updates, predictions),
        "ms_per_env_step": envs,
        "ms_per_env_step_part": parts,
        "env_steps_per_second": rates,
        "ms_per_update": updates,
        "ms_per_prediction": predictions,
        "training_steps_per_second": 1000 / training["all"],
        "ms_per_training_step_part": training,
        "peak_memory": {name: value for name, value in memory.items() if not math.isnan(value)},
        "threads": threads,
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}",
        "versions": ", ".join(f"{name} {found}" for name, found in versions().items()),
    }


def format_value(value: float | None) -> str:
    """Four digits, or a dash."""
    return "–" if value is None else f"{value:.4g}"


def report(result: dict[str, Any]) -> str:
    """`SPEED.md`: a table for everything that the record has."""
    threads = f"{result['threads']} thread(s)"
    titles = {
        "ms_per_env_step": "ms per environment step with two 320 x 240 views, on one core",
        "ms_per_env_step_part": "ms of an environment step, on one core",
        "env_steps_per_second": "environment steps per second in so many processes",
        "ms_per_update": f"ms per gradient step, {threads}",
        "ms_per_prediction": f"ms per predicted action, {threads}",
        "ms_per_training_step_part": f"ms of a training step of hyperparams/ddpg.yml after its warm-up, {threads}",
        "peak_memory": "peak memory of a process in MiB",
    }
    lines = [
        "# Speed",
        "",
        "Written by `python -m benchmarks.speed`; do not edit. Medians of interleaved rounds in one run.",
        "",
        "| ratio | wanted | measured |",
        "| --- | --- | --- |",
        *(f"| {' | '.join(RATIOS[name])} | {format_value(value)} |" for name, value in result["ratios"].items()),
        "",
    ]
    for key, title in titles.items():
        if key in result:
            lines += [f"| {title} | |", "| --- | --- |"]
            lines += [f"| {name} | {format_value(value)} |" for name, value in result[key].items()]
            lines += [""]
    if "training_steps_per_second" in result:
        lines += [f"Such a training takes {result['training_steps_per_second']:.3g} environment steps per second.", ""]
    return "\n".join([*lines, f"On {result['machine']}; {result['versions']}.", ""])


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description="Ratios against the alternatives.")
    parser.add_argument("--json", action="store_true", help="print one object: the ratios, and what they are made of")
    parser.add_argument("--quick", action="store_true", help="few rounds, and nothing is written")
    parser.add_argument("--threads", type=int, default=1, help="of a gradient step (default: 1)")
    args = parser.parse_args(argv)
    with library_lines_to_stderr():
        result = measure(3 if args.quick else 21, args.threads)
    if not args.quick:
        (RESULTS / "speed.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        (FOLDER / "SPEED.md").write_text(report(result), encoding="utf-8")
    print(json.dumps(result.pop("ratios") | result) if args.json else report(result))


if __name__ == "__main__":
    main()
