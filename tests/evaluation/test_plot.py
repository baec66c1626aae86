"""Learning curves: which runs share one, what it is called, and what is drawn."""

from pathlib import Path

import fake_reach
import numpy as np
import pytest

from sb3_stereo.commands import plot
from sb3_stereo.config.schema import load_config
from sb3_stereo.evaluation import curves
from sb3_stereo.evaluation.callback import append_row
from sb3_stereo.runs.creation import create_run
from sb3_stereo.runs.directory import EVALUATIONS

pytest.importorskip("matplotlib")


def make_run(folder: Path, scores: dict[int, float], seed: int = 0, **params: float) -> Path:
    config = load_config("ddpg", fake_reach.ENV_ID, params=params)
    run = create_run(folder, config, {"algo": "ddpg", "env": fake_reach.ENV_ID, "seed": seed})
    for step, score in scores.items():
        append_row(run / EVALUATIONS, {"timesteps": step, **{column: score for column in curves.PANELS}})
    return run


def test_runs_that_differ_in_their_seed_share_a_curve_at_their_common_steps(tmp_path: Path) -> None:
    runs = [make_run(tmp_path, {10: 0.25, 20: 0.5}, seed=1), make_run(tmp_path, {5: 0.0, 10: 0.75}, seed=2)]
    (group,) = curves.group_runs(runs)
    assert group.label == "ddpg (2 runs)" and group.timesteps.tolist() == [10]
    np.testing.assert_array_equal(group.scores["success_rate"], [[25.0], [75.0]])


def test_other_settings_are_another_curve_named_after_them(tmp_path: Path) -> None:
    runs = [make_run(tmp_path, {10: 0.5}, gamma=gamma) for gamma in (0.5, 0.9, 0.5)]
    assert [group.label for group in curves.group_runs(runs)] == ["ddpg, gamma 0.5 (2 runs)", "ddpg, gamma 0.9 (1 run)"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5, "0.5"),
        ({"urdf": "arms/my_arm.urdf", "joints": ["a", "b"]}, "my_arm"),
        ([{"name": "left", "position": [1, 2, 3]}, "right", {"name": "top"}], "left+right+top"),
        ({"a": 1, "b": 2}, "2 fields"),
        ("x" * 60, "x" * 39 + "…"),
    ],
)
def test_long_values_are_said_shortly(value: object, text: str) -> None:
    assert curves.short(value) == text


def test_maps_of_which_several_fields_differ_are_said_once() -> None:
    one = {"algo": "ddpg", "env_kwargs.arm.urdf": "kuka_iiwa/model.urdf", "env_kwargs.arm.damping": [1, 2]}
    other = {"algo": "ddpg", "env_kwargs.arm.urdf": "franka.urdf", "env_kwargs.arm.damping": [3]}
    assert [curves.label(settings, [one, other, {"algo": "ddpg"}]) for settings in (one, other, {"algo": "ddpg"})] == [
        "ddpg, arm model",
        "ddpg, arm franka",
        "ddpg, arm default",
    ]


def test_curves_can_be_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [str(make_run(tmp_path, {10: 0.5}, gamma=gamma)) for gamma in (0.5, 0.9)]
    file = str(tmp_path / "curves.png")
    assert plot.main([*runs, "-o", file, "--labels", "ours", "theirs"]) == 0
    assert capsys.readouterr().out == f"Drew ours, theirs into {file}\n"
    assert plot.main([*runs, "-o", file, "--labels", "ours"]) == 2
    assert capsys.readouterr().err == (
        "error: 1 --labels for 2 curves, which are 'ddpg, gamma 0.5 (1 run)', 'ddpg, gamma 0.9 (1 run)'; "
        "give one each\n"
    )


def test_an_algorithm_has_its_colour_whatever_stands_beside_it() -> None:
    empty = np.array([0]), {}
    groups = [
        curves.Curves(name, *empty) for name in ("dqn (1 run)", "ddpg, gamma 0.5 (1 run)", "ddpg, gamma 0.9 (1 run)")
    ]
    colours = [look["color"] for look in curves._looks(groups)]
    assert colours == [curves.COLOURS["dqn"], curves.COLOURS["ddpg"], curves.COLOURS["ddpg"]]
    assert curves._looks(groups)[1] != curves._looks(groups)[2]


@pytest.mark.parametrize("suffix", plot.FORMATS)
def test_the_picture_is_drawn_also_where_nothing_was_reached(tmp_path: Path, suffix: str) -> None:
    runs = [make_run(tmp_path, {10: float("nan"), 20: value}) for value in (1.0, 2.0)]
    file = tmp_path / f"curves{suffix}"
    assert plot.main([*map(str, runs), "-o", str(file)]) == 0
    assert file.stat().st_size > 5000


def test_runs_without_a_step_in_common_have_a_curve_each(tmp_path: Path) -> None:
    runs = [make_run(tmp_path, {10: 0.25}), make_run(tmp_path, {20: 0.75})]
    assert [(group.label, group.timesteps.tolist()) for group in curves.group_runs(runs)] == [
        ("ddpg, FakeReach-v0_1 (1 run)", [10]),
        ("ddpg, FakeReach-v0_2 (1 run)", [20]),
    ]


def unreadable(tmp_path: Path) -> dict[Path, str]:
    """Folders that cannot be drawn, and why."""
    unscored, broken, cut, foreign = (make_run(tmp_path, {}), *(make_run(tmp_path, {10: 0.5}) for _ in range(3)))
    (broken / EVALUATIONS).write_text("timesteps,success_rate\nten,0.5\n")
    (cut / EVALUATIONS).write_text((cut / EVALUATIONS).read_text()[:-4])
    (foreign / "FakeReach-v0" / "args.yml").write_text("")
    first = "the first comes at the first checkpoint of its training"
    return {
        unscored: f"'{unscored}' has no evaluations yet; {first}",
        broken: f"cannot read the evaluations in '{broken / EVALUATIONS}' (ValueError)",
        cut: f"'{cut}' has no evaluations yet; {first}",
        foreign: f"'{foreign / 'FakeReach-v0'}' is not the record of a training (TypeError)",
        tmp_path: f"'{tmp_path}' is not a run directory; give one such as logs/ddpg/WamStereoReach-v0_1",
    }


def test_what_can_be_drawn_is_drawn_and_the_rest_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    others, good, file = unreadable(tmp_path), make_run(tmp_path, {10: 0.5}), tmp_path / "curves.png"
    assert plot.main([*map(str, others), str(good), str(good), "-o", str(file)]) == 0
    out, err = capsys.readouterr()
    assert out == f"Drew ddpg (1 run) into {file}\n" and file.stat().st_size > 5000
    assert err.splitlines() == [f"left out: {reason}" for reason in others.values()]


def test_what_cannot_be_drawn_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    others, good = unreadable(tmp_path), make_run(tmp_path, {10: 0.5})
    nowhere = tmp_path / "no" / "such.png"
    for arguments, message in (
        ([good, "-o", "curves.gif"], "cannot draw 'curves.gif'; the name must end in .pdf, .png, .svg"),
        *(([run], reason) for run, reason in others.items()),
        ([*others], "; ".join(others.values())),
        ([good, "-o", nowhere], f"cannot write '{nowhere}' (No such file or directory); choose another with -o"),
    ):
        assert plot.main([str(argument) for argument in arguments]) == 2
        assert capsys.readouterr().err == f"error: {message}\n"
