"""The tables of agents in MuJoCo are made from the records alone, and are those in the docs."""

from pathlib import Path

from benchmarks.analysis import mujoco
from benchmarks.analysis.baselines import read_lines

DOCS = Path(__file__).parents[2] / "docs" / "robustness.md"


def line(seed: int, simulator: str, world: str, success: float, steps: float) -> dict[str, str]:
    scores = {"success_rate": str(success), "mean_steps_capped": str(steps), "median_distance_success": "0.03"}
    return {"row": "v1_ours_ddpg", "seed": str(seed), "simulator": simulator, "world": world, **scores}


def test_a_row_is_the_mean_over_an_agents_seeds() -> None:
    worlds = [(simulator, world) for world in mujoco.WORLDS for simulator in mujoco.SIMULATORS]
    lines = [line(seed, *where, 0.5 + seed / 2, 4.0 + seed) for seed in (0, 1) for where in worlds]
    assert mujoco.scores_table(lines) == [
        "| agent, seeds | undisturbed, Bullet | undisturbed, MuJoCo | randomised, Bullet | randomised, MuJoCo |",
        "| --- | --- | --- | --- | --- |",
        "| ours, clean images, 2 | 75 % in 4.5 | 75 % in 4.5 | 75 % in 4.5 | 75 % in 4.5 |",
    ]


def test_the_docs_have_what_is_recorded() -> None:
    scores, agreement = (read_lines(record()) for record in (mujoco.scores_record, mujoco.agreement_record))
    assert scores and agreement
    for table in (mujoco.scores_table(scores), mujoco.agreement_table(agreement)):
        assert "\n".join(table) in DOCS.read_text(encoding="utf-8")


def test_agents_of_bullet_lose_nothing_in_mujoco() -> None:
    for record in read_lines(mujoco.scores_record()):
        if record["world"] == "undisturbed" and record["row"] != "v1_mujoco_ddpg":
            assert float(record["success_rate"]) >= 0.99
