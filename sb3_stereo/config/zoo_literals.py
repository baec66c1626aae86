"""The zoo writes some maps as Python: `policy_kwargs: "dict(net_arch=[400, 300], activation_fn=nn.ReLU)"`.

The zoo evaluates such a text. Here it is only read: of Python's grammar it may use maps, lists, tuples, constants, and
the names of torch's classes.
"""

import ast
from typing import Any, TypeGuard

MODULES = {"nn": "torch.nn", "th": "torch", "torch": "torch", "optim": "torch.optim"}


def parse_map(text: str) -> dict[str, Any]:
    """Return the map that a text writes; a class becomes its dotted path.

    Raises:
        ValueError: If it is anything else than such a map, with the part that is.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ValueError(f"{text!r} is no map") from error
    value = _value(tree.body)
    if not isinstance(value, dict):
        raise ValueError(f"{text!r} is no map")
    return value


def _value(node: ast.expr) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float | str | bool | None):
        return node.value
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        number = _value(node.operand)
        if isinstance(number, int | float):
            return -number
    if isinstance(node, ast.List | ast.Tuple):
        return [_value(item) for item in node.elts]
    if isinstance(node, ast.Dict) and all(isinstance(key, ast.Constant) for key in node.keys):
        return {_value(key): _value(item) for key, item in zip(node.keys, node.values, strict=True) if key is not None}
    if _is_dict_call(node):
        return {str(keyword.arg): _value(keyword.value) for keyword in node.keywords}
    if isinstance(node, ast.Attribute):
        return _path(node)
    raise ValueError(f"'{ast.unparse(node)}' is neither a constant nor a class of torch")


def _is_dict_call(node: ast.expr) -> TypeGuard[ast.Call]:
    """Whether it is `dict(name=value, ...)`."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        return False
    return node.func.id == "dict" and not node.args and all(keyword.arg for keyword in node.keywords)


def _path(node: ast.Attribute) -> str:
    """The dotted path of a class such as `nn.ReLU`."""
    parts = [node.attr]
    inner: ast.expr = node.value
    while isinstance(inner, ast.Attribute):
        parts.append(inner.attr)
        inner = inner.value
    if not isinstance(inner, ast.Name) or inner.id not in MODULES:
        raise ValueError(f"'{ast.unparse(node)}' is neither a constant nor a class of torch")
    return ".".join([MODULES[inner.id], *reversed(parts)])
