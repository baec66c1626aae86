"""Which modules a file may have imported: ours, those of our libraries, and those that the user has named.

Importing a module runs it. So a run's record or a YAML file from elsewhere can name a class of another module, but
only `--gym-packages` imports that.
"""

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType

from sb3_stereo.errors import ConfigError

LIBRARIES = frozenset({"gymnasium", "sb3_contrib", "sb3_stereo", "stable_baselines3", "torch"})


class NotNamedError(ConfigError):
    """A file names a class whose module is not imported for that."""


_named: set[str] = set()  # packages that the user has asked for


def import_packages(names: Iterable[str]) -> None:
    """Import the packages that a user names: they register further environments, or have classes that YAML names.

    Raises:
        ConfigError: If one cannot be imported.
    """
    for name in names:
        try:
            import_module(name)
        except (Exception, SystemExit) as error:  # whatever a package does when it is imported
            reason = f"{type(error).__name__}: {error}" if not isinstance(error, ImportError) else str(error)
            raise ConfigError(f"cannot import the package '{name}' ({reason}); check --gym-packages") from error
        _named.add(name)


def import_installed(names: Sequence[str]) -> None:
    """Import those packages of a record of the user's own that are found wherever one stands.

    What is in the current folder may have come with the record: it stays for `import_packages`.
    """
    with _without_current_folder():
        import_packages(name for name in names if name in sys.modules or is_installed(name))


def is_installed(name: str) -> bool:
    """Return whether a package is found outside of the current folder and of the standard library."""
    top = name.partition(".")[0]
    if not top.isidentifier() or top in sys.stdlib_module_names:
        return False
    with _without_current_folder():
        return _is_found(top)


def _is_found(name: str) -> bool:
    """Whether there is a top-level module of that name; it is not imported for that."""
    return any(finder.find_spec(name, None) is not None for finder in sys.meta_path)


@contextmanager
def _without_current_folder() -> Iterator[None]:
    """Leave the current folder out of the search for modules; `python -m` puts it first."""
    before, here = sys.path[:], Path.cwd()
    sys.path[:] = [entry for entry in before if entry and not (os.path.isdir(entry) and here.samefile(entry))]
    try:
        yield
    finally:
        sys.path[:] = before


def import_known(module: str, name: str) -> ModuleType:
    """Import the module of a class that a file names.

    Args:
        module: Dotted path.
        name: What names it, for messages.

    Raises:
        NotNamedError: If it is neither imported, nor of our libraries, nor of a package that the user has named.
        ImportError: If there is none.
    """
    parents = {module.rsplit(".", n)[0] for n in range(module.count(".") + 1)}
    if module not in sys.modules and not parents & (LIBRARIES | _named) and _is_found(module.partition(".")[0]):
        way_out = f"if you trust it, add --gym-packages {module}"
        raise NotNamedError(f"{name}: '{module}' is not imported because a file names it; {way_out}")
    return import_module(module)
