"""The check of Host and Origin by which a server on this computer refuses pages of other web sites.

A page that a browser shows may send requests and open WebSockets to the loopback interface, and, under a name that its
owner lets point to 127.0.0.1 (DNS rebinding), even count as the same site. The browser reports both: the page's site in
the header ``Origin``, the name in ``Host``.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Collection, Sequence
from typing import Final
from urllib.parse import urlsplit

from gyrowheel_core.errors import InputError

LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
#: Origin of desktop viewers, which show pages of their own from the disk.
DESKTOP: Final = "file://"
_WEB: Final = 80  # port that browsers leave out of an address
_ORIGIN: Final = re.compile(r"https?://(\[[0-9a-fA-F:]+\]|[A-Za-z0-9.-]+)(:\d{1,5})?")
_LONGEST: Final = 100  # characters of a header that a refusal quotes


def is_loopback(address: str) -> bool:
    """Return whether an address belongs to the loopback interface."""
    try:
        return address == "localhost" or ipaddress.ip_address(address.strip("[]")).is_loopback
    except ValueError:
        return False


def in_url(address: str) -> str:
    """Return an address as browsers write it: a name in lower case, IPv6 short and in brackets."""
    name = address.strip("[]").lower()
    try:
        parsed = ipaddress.ip_address(name)
    except ValueError:
        return name
    return f"[{parsed.compressed}]" if parsed.version == 6 else str(parsed)


def host_names(address: str, port: int) -> tuple[str, ...]:
    """Return the values of ``Host`` with which browsers address a server, by its address or the loopback interface."""
    hosts = tuple(dict.fromkeys((*LOOPBACK, in_url(address))))
    names = tuple(f"{host}:{port}" for host in hosts)
    return (*names, *hosts) if port == _WEB else names


def web_origins(text: str) -> tuple[str, ...]:
    """Return the web origins in a text, separated by spaces or commas.

    Raises
    ------
    InputError
        If one of them is not ``http(s)://HOST[:PORT]``.
    """
    origins = tuple(text.replace(",", " ").split())
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            raise InputError(f"origin: {origin!r}; allowed: http(s)://HOST[:PORT], without a path")
    return tuple(origin.lower() for origin in origins)


def refusal(
    hosts: Sequence[str],
    origins: Sequence[str],
    *,
    names: Collection[str],
    allowed: Collection[str],
    local_pages: bool = False,
) -> str:
    """Return why a request is refused; empty if it is accepted.

    Parameters
    ----------
    hosts, origins : sequence of str
        Values of its headers ``Host`` and ``Origin``.
    names : collection of str
        Accepted values of ``Host`` (`host_names`).
    allowed : collection of str
        Accepted values of ``Origin``, in lower case. A request without one does not come from a page.
    local_pages : bool
        Whether pages that this computer serves on any port are accepted, too.
    """
    if len(hosts) != 1 or hosts[0].lower() not in names:
        return f"host {', '.join(hosts)[:_LONGEST] or 'missing'}: not a name of this server"
    if len(origins) > 1:
        return "more than one origin"
    if origins and not _is_accepted(origins[0].lower(), allowed, local_pages=local_pages):
        return f"origin {origins[0][:_LONGEST]}: a page of another site"
    return ""


def _is_accepted(origin: str, allowed: Collection[str], *, local_pages: bool) -> bool:
    if origin in allowed:
        return True
    is_web = local_pages and _ORIGIN.fullmatch(origin) is not None
    return is_web and re.sub(r":\d+$", "", urlsplit(origin).netloc) in LOOPBACK
