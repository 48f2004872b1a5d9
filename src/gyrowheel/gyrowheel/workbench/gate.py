"""Who may use the workbench: the browser of its user, and no page of another site.

A page of another site may send requests to this computer, and, by a name that its owner lets point here (DNS
rebinding), even read the answers. Browsers tell both: the name in ``Host``, the page's site in
``Origin`` and ``Sec-Fetch-Site``.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Mapping
from dataclasses import dataclass

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
#: Cookie that holds the token.
COOKIE = "gyrowheel_workbench"


def is_loopback(address: str) -> bool:
    """Return whether an address is of this computer alone."""
    try:
        return address == "localhost" or ipaddress.ip_address(address.strip("[]")).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Gate:
    """The rules of one server.

    Attributes
    ----------
    names : tuple of str
        Names with port by which it may be called.
    token : str
        What a browser must have been given; empty where none is asked for.
    """

    names: tuple[str, ...]
    token: str = ""

    @classmethod
    def of(cls, address: str, port: int, *, token: bool = False) -> Gate:
        """Return the rules for an address: any but loopback asks for a token, which is made up here.

        With `token` loopback asks for one, too.
        """
        alone = is_loopback(address)
        hosts = LOOPBACK if alone else (*LOOPBACK, address)
        return cls(
            tuple(f"{host}:{port}" for host in hosts),
            secrets.token_urlsafe(24) if token or not alone else "",
        )

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Return why a request may not pass; empty if it may. The token is another matter."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if host.lower() not in self.names:
            return f"Host {host[:100]!r}: this server is not called so"
        if origin is not None and origin.lower() not in {f"http://{name}" for name in self.names}:
            return f"Origin {origin[:100]!r}: a page of another site"
        if headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
            return "a page of another site"
        return ""

    def knows(self, token: str | None) -> bool:
        """Return whether a browser that shows this token may pass."""
        return not self.token or hmac.compare_digest((token or "").encode(), self.token.encode())
