"""A report is one file that holds everything it shows, whatever a record says."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from tiny_training import QUICK, TINY

from sb3_stereo.commands import report
from sb3_stereo.commands import train as train_cli
from sb3_stereo.evaluation import html_report
from sb3_stereo.evaluation.disturbances import CLEAN, Score, draw, write_scores

pytest.importorskip("matplotlib")
pytest.importorskip("imageio_ffmpeg")

NAN = float("nan")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny run on the real environment."""
    logs = tmp_path_factory.mktemp("logs")
    flags = ["-n", "24", "--eval-freq", "12", "--eval-episodes", "2", "--n-eval-envs", "1", *QUICK[:4]]
    flags += ["--env-kwargs", "max_episode_steps:2", "-params", *TINY, "--verbose", "0"]
    assert train_cli.main(["--algo", "ddpg", "--seed", "1", "-f", str(logs), *flags]) == 0
    return logs / "ddpg" / "WamStereoReach-v1_1"


def write(run: Path, *flags: str) -> int:
    return report.main([str(run), "--num-threads", "1", "--device", "cpu", *flags])


def test_a_runs_report_holds_film_curves_scores_and_settings(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert write(run, "--n-episodes", "1") == 0
    assert capsys.readouterr().out == f"Written: {run / 'report.html'}\n"
    text = (run / "report.html").read_text()
    headings = ["Film", "Learning curves", "Evaluations", "Settings", "Command", "Versions"]
    assert re.findall("<h2>(.*)</h2>", text) == headings
    assert "data:video/mp4;base64," in text and "data:image/png;base64," in text
    assert "<td>policy_kwargs.n_critics</td><td>2</td>" in text
    assert re.findall(r'(?:src|href)="(?!data:)', text) == [] and "http" not in re.sub('base64,[^"]*', "", text)


def test_disturbances_are_shown_if_the_run_was_scored_on_them(run: Path) -> None:
    scores = [
        Score(CLEAN, "", "", NAN, "", 1.0, 3.5, 0.9, 40),
        Score("noise", "sensor", "hard", 40.0, "", 0.5, 9, 0.4, 40),
    ]
    write_scores(run / "disturbances.csv", scores)
    draw({"agent": scores}, run / "disturbances.png")
    assert write(run, "--n-episodes", "0", "-o", str(run / "other.html")) == 0
    text = (run / "other.html").read_text()
    assert "<h2>Disturbed worlds</h2>" in text and "<h2>Film</h2>" not in text
    assert "undisturbed: 100 % of 40 poses" in text


def test_nothing_in_a_record_becomes_markup() -> None:
    evil = "<script>alert(1)</script>"
    for text in (html_report.preformatted(evil), html_report.table([[evil], [evil]]), html_report.section(evil, "")):
        assert "<script>" not in text and "&lt;script&gt;" in text
    assert "<title>&lt;script&gt;" in html_report.page(evil, [])


def test_a_sweeps_report_holds_its_trials(tmp_path: Path) -> None:
    folder = tmp_path / "gamma"
    folder.mkdir()
    (folder / "sweep.yml").write_text(yaml.safe_dump({"method": "grid"}))
    assert write(folder) == 2
    (folder / "trials.csv").write_text("run,seed,gamma\nWamStereoReach-v1_1,0,0.5\n")
    assert write(folder) == 0
    text = (folder / "report.html").read_text()
    assert "<th>gamma</th>" in text and "<td>0.5</td>" in text and "method: grid" in text


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["-o", "report.pdf"], "error: -o is 'report.pdf'; give a file that ends in .html\n"),
        (
            ["--n-episodes", "0", "-o", "nowhere/report.html"],
            "error: cannot write 'nowhere/report.html' (No such file or directory); choose another with -o\n",
        ),
    ],
)
def test_a_report_that_cannot_be_written_is_one_sentence(
    flags: list[str], message: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert write(run, *flags) == 2
    assert capsys.readouterr().err == message


def test_a_folder_without_a_run_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[Any]) -> None:
    assert write(tmp_path) == 2
    assert "is not a run directory" in capsys.readouterr().err
