"""The Python of README, pages and notebook runs as it stands, but with shorter training runs."""

import re
from pathlib import Path
from typing import Any

import pytest

from sb3_stereo.config import schema

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/pick.md", "docs/api.md")  # the others' need files of one's own, or LeRobot
CODE = [
    code
    for page in PAGES
    for code in re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
]
NOTEBOOK = ROOT / "docs" / "examples" / "first_agent.ipynb"
# What makes a training short, by what stands in its place.
SHORT = {
    "n_timesteps=8500": 'n_timesteps=12, params={"learning_starts": 6, "batch_size": 4, "buffer_size": 50}',
    "Options(seed=0)": "Options(seed=0, eval_episodes=1, eval_freq=-1)",
    "n_episodes=3": "n_episodes=1",
    "model.learn(2_000)": "model.learn(12)",
    "buffer_size=10_000": "buffer_size=50, learning_starts=6",
    "N_TIMESTEPS = 400": "N_TIMESTEPS = 40",
    '"learning_starts": 200': '"learning_starts": 20, "batch_size": 8',
    "eval_freq=100, eval_episodes=20": "eval_freq=20, eval_episodes=2",
    "[:20]": "[:2]",
}


def shortened(code: str) -> str:
    for long, short in SHORT.items():
        code = code.replace(long, short)
    return code


@pytest.mark.parametrize("code", CODE, ids=lambda code: code.strip().splitlines()[-1][:30])
def test_the_pages_python_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(shortened(code), {"__name__": "__main__"})
    if "film.mp4" in code:
        assert (tmp_path / "film.mp4").stat().st_size > 10_000


def test_every_training_of_the_examples_is_shortened() -> None:
    text = "\n".join([*CODE, NOTEBOOK.read_text().replace('\\"', '"')])
    for long in SHORT:
        assert long in text, "what is shortened stands there no more"
    assert schema.load_config("ddpg", schema.DEFAULT_ENV).n_timesteps == 8500


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nbclient", reason='pip install -e ".[notebook]"')
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook: Any = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "commit it without outputs"
    for cell in notebook.cells:
        cell.source = shortened(cell.source)
    done = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = [o for cell in done.cells for o in cell.get("outputs", []) if "image/png" in o.get("data", {})]
    texts = "".join(o.get("text", "") for cell in done.cells for o in cell.get("outputs", []))
    assert len(pictures) == 2 and "cm from the target" in texts and "as it was trained: 100% reached" in texts
