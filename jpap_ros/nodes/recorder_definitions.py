"""Message definitions as a recording must carry them, so that it can be read without the packages."""

from __future__ import annotations

import re
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

_SEPARATOR = "=" * 80
_FIELD = re.compile(r"^\s*(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*(?!\s*=[^=])")
_PRIMITIVES = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)


def full_definition(type_name: str) -> str:
    """Return the definition of a message type with those of all types in it.

    The form is that of MCAP's schema encoding `ros2msg`, https://mcap.dev/spec/registry#ros2msg: the `.msg` text of the
    type itself, then for each type in it a line of equal signs, a line `MSG: <package>/<Type>` and its text.

    Parameters
    ----------
    type_name : str
        E.g. `geometry_msgs/msg/PoseStamped`.

    Raises
    ------
    LookupError
        If a definition is not installed.
    """
    texts: dict[str, str] = {}
    waiting = [type_name.replace("/msg/", "/")]
    while waiting:
        name = waiting.pop(0)
        if name in texts:
            continue
        texts[name] = _installed_text(name)
        waiting += sorted(_types_in(texts[name], name.partition("/")[0]))
    root, *parts = texts.items()
    return root[1] + "".join(f"\n{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in parts)


def _installed_text(name: str) -> str:
    package, _, kind = name.partition("/")
    try:
        return (Path(get_package_share_directory(package)) / "msg" / f"{kind}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError) as error:
        raise LookupError(f"the definition of {name} is not installed: {error}") from None


def _types_in(text: str, package: str) -> set[str]:
    """Names of the message types that a definition's fields have."""
    found = set()
    for line in text.splitlines():
        match = _FIELD.match(line.partition("#")[0])
        if match and match["type"] not in _PRIMITIVES:
            kind = match["type"].replace("/msg/", "/")
            found.add(kind if "/" in kind else f"{package}/{kind}")
    return found
