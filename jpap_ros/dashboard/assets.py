"""The page's files, read once: what was not shipped cannot be asked for."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

STATIC = Path(__file__).parent / "static"

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
}


@dataclass(frozen=True)
class Asset:
    """One file."""

    body: bytes
    content_type: str
    etag: str


def load_assets(folder: Path = STATIC) -> dict[str, Asset]:
    """Files by the path that a browser asks for; `/` is the page itself."""
    assets = {
        f"/{path.relative_to(folder).as_posix()}": _asset(path)
        for path in sorted(folder.rglob("*"))
        if path.suffix in _TYPES
    }
    assets["/"] = assets["/index.html"]
    return assets


def _asset(path: Path) -> Asset:
    body = path.read_bytes()
    return Asset(body, _TYPES[path.suffix], f'"{hashlib.sha256(body).hexdigest()[:16]}"')
