"""Who may see the page and command: the token, and the headers by which a foreign page in the same browser shows."""

from __future__ import annotations

import hmac
import ipaddress
import socket
from pathlib import Path
from urllib.parse import urlsplit

from jpap_ros.fleet.secret_file import read_secret

MIN_TOKEN = 16


class AccessError(ValueError):
    """The page cannot be served as asked; the message names the parameter, never the token."""


class Access:
    """Decides by token, Host and Origin.

    Parameters
    ----------
    host : str
        Address to listen on.
    token : str or None
        What every page has to send before it is told or obeyed anything; None to ask for none.

    Raises
    ------
    AccessError
        If the address is not one, or is reachable from other machines and there is no token.
    """

    def __init__(self, host: str, token: str | None) -> None:
        self._token = token
        try:
            loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
        except ValueError:
            raise AccessError(f"host must be an IP address or localhost, got {host!r}") from None
        if not loopback and token is None:
            raise AccessError(
                f"host {host!r} can be reached from other machines: set token_file, or listen on 127.0.0.1"
            )
        self._names = {"localhost", socket.gethostname().lower()}

    def token_is_right(self, token: object) -> bool:
        """Compare in a time that tells nothing about how much of it was right."""
        if self._token is None:
            return True
        given = token if isinstance(token, str) else ""
        return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), self._token.encode())

    def host_problem(self, host: str | None) -> str | None:
        """Say what is wrong with a request's Host header, or None.

        An attacker's name can be made to point here (DNS rebinding), and the browser then takes the attacker's page
        for ours. An address cannot, nor can this machine's own name.
        """
        name = _hostname(f"//{host}") if host else None
        if name is None:
            return "the Host header is missing or wrong"
        if name in self._names or _is_address(name):
            return None
        return f"the host name {name[:100]!r} is not this machine's; use its address"

    def origin_problem(self, origin: str | None, host: str | None) -> str | None:
        """Say why the page that a WebSocket comes from is not ours, or None. A browser always tells its origin."""
        if origin and host and origin.lower() in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return None
        return f"the page's origin {(origin or 'unknown')[:100]!r} is not this server"


def load_token(path: Path) -> str:
    """Read the token file; AccessError if it cannot be read, others can read it, or the token is too short."""
    try:
        token = read_secret(path).decode("utf-8").strip()
    except ValueError as error:
        why = "must be UTF-8 text" if isinstance(error, UnicodeDecodeError) else error
        raise AccessError(f"token_file {path}: {why}") from None
    if len(token) < MIN_TOKEN:
        raise AccessError(f"token_file {path}: the token must have at least {MIN_TOKEN} characters, got {len(token)}")
    return token


def _hostname(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
