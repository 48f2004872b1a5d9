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
_COOKIE = "gyrowheel_workbench"
_WEB = 80  # port that browsers leave out of an address


def is_loopback(address: str) -> bool:
    """Return whether an address is of this computer alone."""
    try:
        return address == "localhost" or ipaddress.ip_address(address.strip("[]")).is_loopback
    except ValueError:
        return False


def in_url(address: str) -> str:
    """Return an address as browsers write it: a name in small letters, IPv6 short and in brackets."""
    name = address.strip("[]").lower()
    try:
        own = ipaddress.ip_address(name)
    except ValueError:
        return name
    return f"[{own.compressed}]" if own.version == 6 else str(own)


@dataclass(frozen=True)
class Gate:
    """The rules of one server.

    Attributes
    ----------
    names : tuple of str
        Names with port by which it may be called.
    token : str
        What a browser must have been given; empty where none is asked for.
    cookie : str
        Name of the cookie that holds the token: of this server alone, as a cookie is sent to every port of a computer.
    """

    names: tuple[str, ...]
    token: str = ""
    cookie: str = _COOKIE

    @classmethod
    def of(cls, address: str, port: int, *, token: bool = False) -> Gate:
        """Return the rules for an address: any but loopback asks for a token, which is made up here.

        With `token` loopback asks for one, too.
        """
        hosts = tuple(dict.fromkeys((*LOOPBACK, in_url(address))))
        names = tuple(f"{host}:{port}" for host in hosts)
        return cls(
            (*names, *hosts) if port == _WEB else names,
            secrets.token_urlsafe(24) if token or not is_loopback(address) else "",
            f"{_COOKIE}_{port}",
        )

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Return why a request may not pass; empty if it may. The token is another matter."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if host.lower() not in self.names:
            return f"Host {host[:100]!r}: this server is not called so"
        if origin is not None and origin.lower() not in {f"http://{name}" for name in self.names}:
            return f"Origin {origin[:100]!r}: a page of another site"
        if headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
            return (
                "a page of another site asks for it; to open the workbench, type its address in the browser"
            )
        return ""

    def knows(self, token: str | None) -> bool:
        """Return whether a browser that shows this token may pass."""
        return not self.token or hmac.compare_digest((token or "").encode(), self.token.encode())
