"""The folders import as the diagram in docs/architecture.md says: downwards, and `envs` nothing of the plug-in."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PLUGIN = ROOT / "sb3_stereo"
DIAGRAM = (ROOT / "docs" / "images" / "architecture.svg").read_text()
LAYERS = {name: int(y) for y, name in re.findall(r'class="folder" x="\d+" y="(\d+)"[^>]*>(\w+)<', DIAGRAM)}
DATA = {"hyperparams", "pretrained"}


def folders() -> list[Path]:
    return sorted(file.parent for file in PLUGIN.glob("*/__init__.py"))


def imported(folder: Path) -> Iterator[tuple[str, str]]:
    """A folder's files, with the folders of ours that each imports from."""
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                parts = module.split(".")
                if parts[0] == "sb3_stereo" and len(parts) > 1 and (PLUGIN / parts[1]).is_dir():
                    yield file.name, parts[1]


def test_the_diagram_shows_every_folder() -> None:
    assert set(LAYERS) == {folder.name for folder in folders()} - DATA


def test_imports_go_down() -> None:
    upwards = [
        f"{folder.name}/{file} imports {target}"
        for folder in folders()
        if folder.name not in DATA
        for file, target in imported(folder)
        if target not in DATA and target != folder.name and LAYERS[target] <= LAYERS[folder.name]
    ]
    assert upwards == []
