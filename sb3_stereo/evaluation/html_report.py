"""One HTML file about a run or a sweep: film, curves, scores, settings. It loads nothing from elsewhere."""

import base64
import csv
import html
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from sb3_stereo import __version__
from sb3_stereo.building.factory import make_env
from sb3_stereo.config.schema import Config, settings
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation import curves, disturbances
from sb3_stereo.evaluation.scores import read_scores, score_table
from sb3_stereo.runs.directory import arguments_file, load_record
from sb3_stereo.viz.film import film

SWEEP_FILES = {"sweep.yml": "The sweep", "best.yml": "The best setting"}
STYLE = """
:root { color-scheme: light dark; --line: color-mix(in srgb, currentColor 20%, transparent); }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
img, video { max-width: 100%; background: white; border-radius: 4px; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
td, th { padding: .2rem .8rem; text-align: left; border-bottom: 1px solid var(--line); }
pre { overflow-x: auto; padding: .8rem; border: 1px solid var(--line); border-radius: 4px; }
"""


def run_report(run: Path, model: Any, n_episodes: int) -> str:
    """Return the page of a run.

    Args:
        run: Its directory.
        model: Its agent, for the film.
        n_episodes: Of the film; 0 leaves it out.

    Raises:
        ConfigError: If the directory holds no run, or it has no evaluations yet.
    """
    config, _ = load_record(run)
    by_step = read_scores(run)
    last = by_step[max(by_step)]
    title = f"{config.algo} on {config.env_id}"
    lead = f"{100 * last['success_rate']:.0f} % of the test poses after {max(by_step)} environment steps"
    parts = [f"<h1>{html.escape(title)}</h1><p>{html.escape(lead)}; run <code>{html.escape(str(run))}</code></p>"]
    if n_episodes:
        parts.append(section("Film", embedded_film(config.evaluated, model, n_episodes)))
    parts.append(section("Learning curves", embedded_curves(run)))
    parts.append(section("Evaluations", preformatted(score_table(by_step))))
    parts += disturbed(run)
    rows = [[key, str(value)] for key, value in settings(config).items()]
    parts.append(section("Settings", table([["setting", "value"], *rows])))
    records = arguments_file(run).parent
    for name, heading in (("command.txt", "Command"), ("versions.yml", "Versions")):
        if (records / name).is_file():
            parts.append(section(heading, preformatted((records / name).read_text(encoding="utf-8"))))
    return page(title, parts)


def sweep_report(folder: Path) -> str:
    """Return the page of a sweep's folder, from what its report has written there.

    Raises:
        ConfigError: If nothing has been trained yet.
    """
    trials = folder / "trials.csv"
    if not trials.is_file():
        raise ConfigError(f"'{folder}' has no trials yet; the sweep writes them at its end, or with --report")
    title = f"Sweep {folder.resolve().name}"
    parts = [f"<h1>{html.escape(title)}</h1>"]
    if (folder / "slices.png").is_file():
        parts.append(section("The metric over each parameter", picture(folder / "slices.png", "slices")))
    with trials.open(newline="", encoding="utf-8") as file:
        parts.append(section("Trials", table(list(csv.reader(file)))))
    for name, heading in SWEEP_FILES.items():
        if (folder / name).is_file():
            parts.append(section(heading, preformatted((folder / name).read_text(encoding="utf-8"))))
    return page(title, parts)


def embedded_film(config: Config, model: Any, n_episodes: int) -> str:
    """Film the agent, and return the video."""
    env = make_env(config.env_id, config.env_kwargs, config.env_wrapper)()
    with tempfile.TemporaryDirectory() as folder, closing(env):
        if not hasattr(env.unwrapped, "look"):
            return "<p>This environment cannot be filmed.</p>"
        data = film(model, env, Path(folder) / "film.mp4", n_episodes).read_bytes()
    source = f"data:video/mp4;base64,{base64.b64encode(data).decode()}"
    return f'<video controls autoplay loop muted playsinline src="{source}"></video>'


def embedded_curves(run: Path) -> str:
    """Draw the run's curves, and return the picture."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "curves.png"
        curves.draw(curves.group_runs([run]), file)
        return picture(file, "learning curves")


def disturbed(run: Path) -> Iterator[str]:
    """The section on the disturbance suite, if the run was scored on it."""
    file = run / "disturbances.csv"
    if not file.is_file():
        return
    with file.open(newline="", encoding="utf-8") as stream:
        scores = disturbances.read_scores(list(csv.DictReader(stream)))
    content = preformatted(disturbances.table(scores))
    if file.with_suffix(".png").is_file():
        content = picture(file.with_suffix(".png"), "success over the size of the change") + content
    yield section("Disturbed worlds", content)


def section(title: str, content: str) -> str:
    """A heading and what is below it."""
    return f"<h2>{html.escape(title)}</h2>\n{content}"


def table(rows: Sequence[Sequence[str]]) -> str:
    """A table, its head first."""
    head, *body = rows
    lines = ["<tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in body]
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def preformatted(text: str) -> str:
    """Text as it stands."""
    return f"<pre>{html.escape(text)}</pre>"


def picture(file: Path, name: str) -> str:
    """A PNG, in the page itself."""
    data = base64.b64encode(file.read_bytes()).decode()
    return f'<img alt="{html.escape(name)}" src="data:image/png;base64,{data}">'


def page(title: str, parts: Sequence[str]) -> str:
    """The whole document."""
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style></head>\n<body>\n{body}\n"
        f"<p><small>Written by sb3_stereo {__version__}.</small></p>\n</body>\n</html>\n"
    )


def write_report(text: str, file: Path) -> None:
    """Write the page.

    Raises:
        ConfigError: If it cannot be written.
    """
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write '{os.fspath(file)}' ({error.strerror}); choose another with -o") from error
