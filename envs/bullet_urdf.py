"""A URDF loaded by Bullet, and what Bullet says of it."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sb3_stereo.envs.bullet import native_output, pybullet
from sb3_stereo.envs.specs import quoted, require


def load_urdf(client: Any, path: str, position: Any, orientation: Any, flags: int) -> int:
    """Load a robot, fixed at its base, and return its body; what Bullet says of the file becomes one warning.

    Raises:
        ValueError: If Bullet cannot load it or one of its meshes.
    """
    with bullet_says() as said:
        try:
            body = int(client.loadURDF(path, position, orientation, useFixedBase=True, flags=flags))
        except pybullet.error as error:
            body, reason = -1, str(error)
    sentences = list(dict.fromkeys(said))
    all_said = "; ".join(sentences).replace(":;", ":").replace(";;", ";")
    if body < 0:
        raise ValueError(f"Bullet cannot load {quoted(path)} ({all_said or reason}); check it and the meshes it names")
    for sentence in sentences:
        mesh = re.search(r"cannot extract .*'(.*)'", sentence)
        require(
            mesh is None, f"Bullet finds no shape in the mesh {quoted(mesh and mesh[1])} of {quoted(path)}; check it"
        )
    if sentences:
        warnings.warn(f"Bullet says of {quoted(path)}: {all_said}", stacklevel=2)
    return body


@contextmanager
def bullet_says() -> Iterator[list[str]]:
    """Collect the warnings that Bullet's C++ prints on standard output, where they would break a command's JSON."""
    lines: list[str] = []
    with native_output(1) as printed:
        yield lines
    for text in printed:
        text = re.sub(r"No inertial data for link, using mass=1.*\n?.*", "", text)  # not with us
        text = re.sub(r"b3(Warning|Error|Printf)\[[^\]]*\]:?\n?", "\n", text)
        lines += [line for line in map(str.strip, text.split("\n")) if line]
