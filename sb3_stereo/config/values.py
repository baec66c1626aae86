"""Plain values from YAML files and from `key:value` arguments; nothing in them is evaluated."""

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from sb3_stereo.envs import plain_yaml
from sb3_stereo.errors import ConfigError, unknown


def read_hyperparams(algo: str, env_id: str, conf_file: str | Path | None = None) -> dict[str, Any]:
    """Return the map for one environment from a YAML file, by default our own for the algorithm."""
    source = Path(conf_file).expanduser() if conf_file else resources.files("sb3_stereo.hyperparams") / f"{algo}.yml"
    if not _is_file(source):
        way_out = "give an existing file with -conf" if conf_file is None else "check the path given with -conf"
        raise ConfigError(f"no hyper-parameter file '{source if conf_file else algo + '.yml'}'; {way_out}")
    content = read_yaml(source)
    if not isinstance(content, Mapping):
        raise ConfigError(f"'{source}' must hold one map per environment id, or 'default'")
    values = content.get(env_id, content.get("default"))
    if not isinstance(values, Mapping):
        raise unknown(f"environment of '{source}'", env_id, [str(key) for key in content])
    return {str(key): value for key, value in values.items()}


def _is_file(source: Any) -> bool:
    try:
        return bool(source.is_file())
    except (OSError, ValueError):  # no path: too long, or with a NUL in it
        return False


def read_yaml(source: Any) -> Any:
    """Return what is in an existing YAML file; `1e-3` is a number.

    Args:
        source: The file, as a path or a package's resource.

    Raises:
        ConfigError: If it cannot be read, or is not plain YAML.
    """
    try:
        return plain_yaml.read(source)
    except OSError as error:
        raise ConfigError(f"cannot read '{source}' ({error.strerror}); make it readable") from error
    except ValueError as error:
        raise ConfigError(f"'{source}' is not plain YAML: {error}") from error


def parse_assignments(assignments: Sequence[str] | None) -> dict[str, Any]:
    """Read `key:value` arguments of the command line; the value is YAML, and `1e-3` is a number.

    Raises:
        ConfigError: If an argument has no colon, or its value is not YAML.
    """
    values = {}
    for assignment in assignments or ():
        key, colon, text = assignment.partition(":")
        if not colon or not key:
            raise ConfigError(f"'{assignment}' is not of the form key:value, as in learning_starts:100")
        try:
            values[key] = plain_yaml.parse(text)
        except ValueError as error:
            raise ConfigError(f"the value of '{assignment}' is not YAML ({error}); quote it") from error
    return values


def override_all(values: Mapping[str, Any], params: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a copy of the map with overrides by key; a dotted key reaches inside (`policy_kwargs.n_critics`).

    In a list of classes it names one by its last name, as in `callback.WarmUp.replay_ratio`.
    """
    values = dict(values)
    for key, value in (params or {}).items():
        values = override(values, key.split("."), value, key)
    return values


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a map of maps as one map with dotted keys, as in `policy_kwargs.n_critics`."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= flatten(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat


def override(values: Mapping[str, Any], path: Sequence[str], value: Any, name: str) -> dict[str, Any]:
    """Return a copy of the map with the value at the path replaced."""
    first, *rest = path
    if not rest:
        return {**values, first: value}
    inner = values.get(first)
    if isinstance(inner, list):
        return {**values, first: _override_item(inner, rest, value, name)}
    if not isinstance(inner, Mapping | None):
        raise ConfigError(f"'{name}' reaches inside '{first}', which is {inner!r} and not a map")
    return {**values, first: override(inner or {}, rest, value, name)}


def _override_item(items: Sequence[Any], path: Sequence[str], value: Any, name: str) -> list[Any]:
    """Return a copy of a list of classes with an argument of one replaced."""
    first, *rest = path
    maps = [item if isinstance(item, Mapping) else {str(item): {}} for item in items]
    paths = {next(iter(item)).rpartition(".")[2]: next(iter(item)) for item in maps}
    if first not in paths or not rest:
        raise unknown(f"class or argument in '{name}'", ".".join(path), [f"{known}.<argument>" for known in paths])
    return [override(item, [paths[first], *rest], value, name) if paths[first] in item else item for item in maps]
