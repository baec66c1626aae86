"""Classes that YAML names by their dotted path, and checked arguments for them."""

import inspect
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sb3_stereo.config import limits
from sb3_stereo.config.modules import NotNamedError, import_known
from sb3_stereo.config.validation import fits
from sb3_stereo.errors import ConfigError, unknown

_DOTTED = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)+")
_ZOO_NAMES = {"HerReplayBuffer": "stable_baselines3.HerReplayBuffer"}
_SKIPPED = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)


@dataclass(frozen=True)
class Component:
    """A class by its dotted path, with its keyword arguments.

    Attributes:
        path: Where the class is, e.g. `sb3_stereo.envs.wrappers.QuantizedActions`.
        kwargs: Keyword arguments, checked against the class.
    """

    path: str
    kwargs: Mapping[str, Any] = field(default_factory=dict)

    def plain(self) -> str | dict[str, Any]:
        """Return the value as YAML writes it."""
        return {self.path: dict(self.kwargs)} if self.kwargs else self.path


def import_class(path: object, kind: type, name: str) -> type:
    """Import a class and make sure that it is of the right kind; the zoo's `HerReplayBuffer` is SB3's.

    Args:
        path: Dotted path, `package.module.Class`.
        kind: The base class it must have.
        name: The setting's name, for messages.

    Raises:
        ConfigError: If there is no such class, or it is of another kind.
    """
    path = _ZOO_NAMES.get(str(path), path)
    if not isinstance(path, str) or not _DOTTED.fullmatch(path):
        raise ConfigError(f"{name} must be a dotted path 'package.module.Class', got {path!r}")
    module, _, attribute = path.rpartition(".")
    try:
        found = getattr(import_known(module, name), attribute)
    except NotNamedError:
        raise
    except Exception as error:  # whatever a module does when it is imported
        raise ConfigError(f"{name}: cannot import '{path}' ({error}); the form is package.module.Class") from error
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise ConfigError(f"{name}: '{path}' is not a subclass of {kind.__name__}; name one that is")
    return found


def parse_components(value: object, kind: type, name: str) -> tuple[Component, ...]:
    """Read the zoo's wrapper and callback syntax: a dotted path, `{path: kwargs}`, or a list of these."""
    items = value if isinstance(value, list) else [] if value is None else [value]
    return tuple(_parse_component(item, kind, name) for item in items)


def _parse_component(item: object, kind: type, name: str) -> Component:
    if isinstance(item, Mapping) and len(item) == 1:
        path, kwargs = next(iter(item.items()))
    else:
        path, kwargs = item, {}
    if not isinstance(kwargs, Mapping | None):
        raise ConfigError(f"{name}: the arguments of '{path}' must be a map, got {kwargs!r}")
    cls = import_class(path, kind, name)
    checked = check_kwargs(cls, kwargs or {}, f"{name} {cls.__name__}", skip={"env"})
    for key, parameter in parameters(cls).items():
        if parameter.default is parameter.empty and key not in {"env", *checked}:
            raise ConfigError(f"{name} {cls.__name__} lacks '{key}'; add it, as in {{{path}: {{{key}: ...}}}}")
    return Component(str(path), checked)


def parameters(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the keyword arguments of a callable; a class with `**kwargs` adds those of its bases."""
    if not isinstance(target, type):
        return {k: p for k, p in _signature(target).items() if p.kind not in _SKIPPED}
    found: dict[str, inspect.Parameter] = {}
    for cls in target.__mro__:
        if "__init__" not in vars(cls):
            continue
        own = _signature(vars(cls)["__init__"])
        own.pop("self", None)
        found = {k: p for k, p in own.items() if p.kind not in _SKIPPED} | found
        if all(p.kind != inspect.Parameter.VAR_KEYWORD for p in own.values()):
            break
    return found


def _signature(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    try:
        return dict(inspect.signature(target, eval_str=True).parameters)
    except NameError:  # an annotation that only the type checker can resolve: its values stay unchecked
        return dict(inspect.signature(target).parameters)


def check_kwargs(
    target: Callable[..., Any], kwargs: Mapping[str, Any], name: str, skip: typing.Collection[str] = ()
) -> dict[str, Any]:
    """Check arguments against a callable's signature.

    Args:
        target: What will be called.
        kwargs: The arguments as YAML gives them.
        name: What they are for, for messages.
        skip: Parameters that are not for the user.

    Returns:
        The arguments as plain data; whole floats have become ints where an int is wanted.

    Raises:
        ConfigError: If an argument is unknown or of the wrong type.
    """
    known = {key: p for key, p in parameters(target).items() if key not in skip}
    for key in kwargs:
        if key not in known:
            raise unknown(f"argument of {name}", key, known)
    checked = {key: coerce(value, known[key].annotation, f"{name}: {key}") for key, value in kwargs.items()}
    for key, value in checked.items():
        limits.check(key, value, f"{name}: {key}")
    return checked


def coerce(value: Any, hint: Any, name: str) -> Any:
    """Return the value if it fits the annotation, a whole float as an int where only an int fits.

    Only plain values are judged (numbers, booleans, texts, null, maps) and dotted paths of classes; an annotation of
    any other kind accepts what is not a plain value.

    Raises:
        ConfigError: If the value does not fit.
    """
    options = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    for option in options:
        if typing.get_origin(option) is type and isinstance(value, str):
            import_class(value, typing.get_args(option)[0], name)
    if any(_fits(value, option) for option in options):
        return value
    if isinstance(value, float) and value.is_integer() and int in options:
        return int(value)
    wanted = " or ".join(_spoken(typing.get_origin(option) or option) for option in options)
    raise ConfigError(f"{name} must be {wanted}, got {value!r}")


def resolve_classes(target: Callable[..., Any], kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the dotted path by the class wherever the signature wants a class; lists become tuples."""
    known = parameters(target)
    return {key: _resolve(value, known[key].annotation, key) for key, value in kwargs.items()}


def _resolve(value: Any, hint: Any, name: str) -> Any:
    for option in (hint, *typing.get_args(hint)):
        origin = typing.get_origin(option)
        if origin is type and isinstance(value, str):
            return import_class(value, typing.get_args(option)[0], name)
        if origin is tuple and isinstance(value, list):
            return tuple(value)
    return value


_SPOKEN = {
    int: "an integer",
    float: "a number",
    bool: "true or false",
    str: "a text",
    type(None): "null",
    dict: "a map",
    Mapping: "a map",
    Sequence: "a list",
}


def _spoken(kind: Any) -> str:
    return _SPOKEN.get(kind, getattr(kind, "__name__", str(kind)))


def _fits(value: Any, hint: Any) -> bool:
    if hint in (Any, inspect.Parameter.empty, object) or isinstance(hint, str):
        return True
    if _is_plain(hint):
        return fits(value, hint)
    return not isinstance(value, int | float | bool | None)  # a scalar never stands for an object


def _is_plain(hint: Any) -> bool:
    """Whether a type is made of what YAML can write."""
    inner = [part for part in typing.get_args(hint) if part is not Ellipsis]
    origin = typing.get_origin(hint) or hint
    if origin is typing.Literal or hint is Any:
        return True
    kinds = (int, float, bool, str, type(None), list, tuple, dict, Sequence, Mapping, typing.Union, types.UnionType)
    return origin in kinds and all(map(_is_plain, inner))
