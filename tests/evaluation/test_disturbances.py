"""The disturbance suite: worlds that can be made, scores that are what was played, one table and one picture."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import fake_reach
import numpy as np
import pytest

from sb3_stereo.commands import evaluate
from sb3_stereo.config.schema import check_env_kwargs, load_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.disturbances import (
    CLEAN,
    DISTURBANCES,
    GRADES,
    Score,
    camera_losses,
    draw,
    mean_success,
    read_scores,
    score_disturbances,
    table,
    worlds,
    write_scores,
)
from sb3_stereo.evaluation.protocol import eval_initial_states
from sb3_stereo.runs.models import load_model
from sb3_stereo.runs.pretrained import pretrained_run

NAN = float("nan")
SCORES = [
    Score(CLEAN, "", "", NAN, "", 1.0, 3.5, 0.9, 40),
    Score("noise", "sensor", "mild", 5.0, "of 255", 1.0, 3.6, 0.9, 40),
    Score("noise", "sensor", "middle", 15.0, "of 255", 0.5, 16.0, 0.4, 40),
    Score("noise", "sensor", "hard", 40.0, "of 255", 0.0, 30.0, 0.0, 40),
    Score("no brake", "arm", "hard", 1.0, "", 0.25, 25.0, 0.1, 40),
]


@pytest.fixture(scope="module")
def config() -> Any:
    return load_config("ddpg", "WamStereoReach-v1")


def test_every_world_is_one_that_the_environment_can_make(config: Any) -> None:
    made = list(worlds(config))
    n_cameras = 2
    n_sizes = sum(len(change.sizes) for change in DISTURBANCES)
    assert made[0][0].kind == CLEAN and len(made) == 1 + n_sizes + n_cameras
    for _, kwargs in made:
        check_env_kwargs(config.env_id, kwargs)


def test_a_runs_own_randomisation_is_replaced(config: Any) -> None:
    trained = replace(config, env_kwargs={"randomize": "default", "rho": 7.0})
    assert [kwargs["randomize"] for _, kwargs in worlds(trained, ())] == [{}]
    noise = next(change for change in DISTURBANCES if change.kind == "noise")
    assert [kwargs for _, kwargs in worlds(trained, [noise])][1] == {"randomize": {"noise": 5.0}, "rho": 7.0}


def test_each_camera_is_lost_in_a_world_and_none_in_the_others(config: Any) -> None:
    four = replace(config, env_kwargs={"cameras": ["left", "back_left", "right"], "camera_loss": 0.5})
    assert [change.kind for change in camera_losses(four)] == [
        "camera left lost",
        "camera back_left lost",
        "camera right lost",
    ]
    kwargs = [kwargs for _, kwargs in worlds(four)]
    assert [one.get("lost_camera") for one in kwargs[-4:]] == [None, "left", "back_left", "right"]
    assert not any("camera_loss" in one for one in kwargs)
    assert camera_losses(replace(config, env_id=fake_reach.ENV_ID)) == ()


def test_kinds_are_unique_and_sizes_grow_away_from_what_changes_nothing() -> None:
    assert len({change.kind for change in DISTURBANCES}) == len(DISTURBANCES)
    for change in DISTURBANCES:
        steps = np.diff(change.sizes)
        assert (steps > 0).all() or (steps < 0).all()
        assert change.grades == GRADES[-len(change.sizes) :]


def test_an_agent_is_scored_as_without_the_suite_where_nothing_is_disturbed() -> None:
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.evaluation.protocol import evaluate as score
    from sb3_stereo.runs.directory import load_record, model_path

    run = pretrained_run("ddpg", "WamStereoReach-v1")
    config, _ = load_record(run)
    model = load_model(config, model_path(run, config.env_id), "cpu", False)
    states = eval_initial_states(config.env_id)[:4]
    dark = [change for change in DISTURBANCES if change.kind == "darker"]
    done: list[int] = []
    scores = score_disturbances(model, config, states, wanted=dark, progress=done.append)
    plain = score(model, make_env(config.env_id, config.env_kwargs, ()), states)
    assert (scores[0].success_rate, scores[0].mean_steps_capped) == (1.0, plain.mean_steps_capped)
    assert [one.grade for one in scores] == ["", *GRADES] and done == [1, 2, 3, 4]
    assert all(one.n_poses == 4 for one in scores)


def test_an_environment_without_randomisation_is_refused() -> None:
    config = replace(load_config("ddpg", "WamStereoReach-v1"), env_id=fake_reach.ENV_ID)
    with pytest.raises(ConfigError) as caught:
        list(worlds(config))
    assert str(caught.value) == f"{fake_reach.ENV_ID} has no argument 'randomize', so there is nothing to disturb"


def test_means_are_those_of_the_disturbed_worlds() -> None:
    assert mean_success(SCORES) == (1.0 + 0.5 + 0.0 + 0.25) / 4
    assert [mean_success(SCORES, grade) for grade in GRADES] == [1.0, 0.5, 0.125]


def test_the_table_has_a_line_per_kind() -> None:
    assert table(SCORES).splitlines() == [
        "undisturbed: 100 % of 40 poses, 3.50 steps; mean over 4 disturbed worlds: 44 %",
        "  change    mild               middle             hard",
        "  noise     100 % at 5 of 255  50 % at 15 of 255  0 % at 40 of 255",
        "  no brake                                        25 % at 1",
        "  mean      100 %              50 %               12 %",
    ]


def test_written_scores_are_read_again(tmp_path: Path) -> None:
    file = tmp_path / "scores.csv"
    write_scores(file, SCORES)
    with file.open(newline="") as stream:
        found = read_scores(list(csv.DictReader(stream)))
    assert found[1:] == SCORES[1:]
    assert replace(found[0], size=0.0) == replace(SCORES[0], size=0.0)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    for write in (lambda file: write_scores(file, SCORES), lambda file: draw({"agent": SCORES}, file)):
        with pytest.raises(ConfigError, match=r"cannot write .*; choose another with -o"):
            write(tmp_path / "nowhere" / "scores.png")


def test_the_picture_has_a_panel_per_family(tmp_path: Path) -> None:
    file = tmp_path / "scores.png"
    draw({"agent": SCORES}, file)
    image = cv2.imread(str(file))
    assert image is not None and image.std() > 10


@pytest.mark.parametrize("flags", [["-o", "x.csv"], ["--disturbances", "-o", "x.txt"]])
def test_an_output_that_makes_no_sense_is_refused(flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(["--pretrained", *flags]) == 2
    assert "-o" in capsys.readouterr().err
