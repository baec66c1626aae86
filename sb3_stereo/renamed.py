"""Modules under the names that they had before version 0.1.0; to be removed with 0.2.

Records of older runs, YAML files and `python -m sb3_stereo.train` still use them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, spec_from_loader
from types import CodeType, ModuleType

PACKAGE = "sb3_stereo."
RENAMED = {
    "buffers": "learning.callbacks",
    "check": "commands.check",
    "contrib": "policies.contrib",
    "enjoy": "commands.enjoy",
    "evaluate": "commands.evaluate",
    "exploration": "learning.callbacks",
    "extractors": "policies.extractors",
    "learners": "policies.sac_ppo",
    "models": "runs.models",
    "motion": "learning.callbacks",
    "play_images": "commands.predict",
    "plot": "commands.plot",
    "sweep": "commands.sweep",
    "train": "commands.train",
    "warmup": "learning.callbacks",
}


class _Alias(InspectLoader):
    """Loads nothing: the module is the one of the present name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(self.name)
        self.spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.spec  # the import system has just put the old name's there

    def get_code(self, fullname: str) -> CodeType | None:
        """What `python -m` runs."""
        spec = find_spec(self.name)
        assert spec is not None and isinstance(spec.loader, InspectLoader)
        return spec.loader.get_code(self.name)

    def get_source(self, fullname: str) -> str | None:
        spec = find_spec(self.name)
        assert spec is not None and isinstance(spec.loader, InspectLoader)
        return spec.loader.get_source(self.name)


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        new = RENAMED.get(fullname.removeprefix(PACKAGE)) if fullname.startswith(PACKAGE) else None
        return None if new is None else spec_from_loader(fullname, _Alias(PACKAGE + new))


def install() -> None:
    """Let `import` find the old names, after everything that exists."""
    sys.meta_path.append(_Finder())
