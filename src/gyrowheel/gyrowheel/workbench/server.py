"""The server of the workbench: page, state, signals and actions; on tornado."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import ipaddress
import json
import resource
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO

from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders
from tornado.iostream import IOStream, StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler, stream_request_body

from gyrowheel.report.page import POLICY
from gyrowheel.show.html import style_sheet
from gyrowheel.workbench import pictures, views, windows
from gyrowheel.workbench.benches import FRAME
from gyrowheel.workbench.derived import channel
from gyrowheel.workbench.residual import orders
from gyrowheel.workbench.session import Session
from gyrowheel.workbench.setpoints import read_setpoint
from gyrowheel.workbench.tables import LARGEST as LARGEST_TABLE
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import disk_errors, json_text
from gyrowheel_core.origin_guard import host_names, in_url, is_loopback, refusal
from gyrowheel_core.wire import SECOND
from gyrowheel_recording.bags import load_loops

_LARGEST = 1 << 20  # largest request [bytes]
_PATIENCE = 60.0  # s for the head of a request, and between two of a connection
_MOST_CONNECTIONS = 200
#: Connections that may wait to be accepted. The kernel drops further requests, and a browser tries again only after
#: seconds, at last after a minute.
_BACKLOG = 1024
_NO_ROOM = 0.05  # s until a connection is tried again that found no free descriptor
_BEAT = 15.0  # s between heartbeats to a waiting page
_BEAT_FRAMES = 40  # pieces of a stream without a sample after which an empty one is sent
_PARTING = 0.1  # s in which waiting pages learn of the end
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; font-src 'self' data:; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with "no-referrer" a form says Origin: null, which is refused
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
#: Scripts of Bokeh, from its package.
_LIBRARY = ("bokeh.min.js", "bokeh-api.min.js")


@dataclass(frozen=True)
class Access:
    """Who may use one server: the browser of its user, and no page of another site."""

    names: tuple[str, ...]  # accepted values of ``Host``
    token: str  # of the browsers that are accepted; empty if no token is required
    #: Name of the cookie with the token, with the port in it: browsers send a cookie to every port of a computer.
    cookie: str

    @classmethod
    def of(cls, address: str, port: int, *, token: bool = False) -> Access:
        """Return the rules for an address: any but loopback requires a token; with `token` loopback does, too."""
        required = token or not is_loopback(address)
        return cls(
            host_names(address, port),
            secrets.token_urlsafe(24) if required else "",
            f"gyrowheel_workbench_{port}",
        )

    def refusal(self, headers: HTTPHeaders) -> str:
        """Return why a request is refused, apart from its token; empty if it is accepted."""
        own = [f"http://{name}" for name in self.names]
        why = refusal(headers.get_list("Host"), headers.get_list("Origin"), names=self.names, allowed=own)
        if not why and headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
            return (
                "requested by a page of another site; to open the workbench, type its address in the browser"
            )
        return why

    def knows(self, token: str | None) -> bool:
        """Return whether a browser with this token is accepted."""
        return not self.token or hmac.compare_digest((token or "").encode(), self.token.encode())


class _Guarded(RequestHandler):
    """A request that is answered only where `Access` accepts it."""

    session: Session
    access: Access

    def initialize(self, session: Session, access: Access) -> None:
        self.session, self.access = session, access

    def set_default_headers(self) -> None:
        for name, value in _HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        if why := self.access.refusal(self.request.headers):
            self.set_status(403)
            self.finish({"error": why})
        elif not self.open_to_all and not self.access.knows(self.get_cookie(self.access.cookie)):
            self.refuse_stranger()

    open_to_all = False

    def refuse_stranger(self) -> None:
        """Answer a browser that has no token."""
        self.set_status(401)
        self.finish({"error": "the token is missing: open the page and give it there"})

    def write_error(self, status_code: int, **given: Any) -> None:
        """Answer with a sentence, and no traceback."""
        error = given.get("exc_info", (None, None))[1]
        if isinstance(error, InputError):
            self.set_status(422)
            self.finish({"error": str(error)})
        else:
            self.finish({"error": self._reason})

    def log_exception(self, kind: Any, value: Any, trace: Any) -> None:
        """Log no errors that the user is shown."""
        if not isinstance(value, InputError | HTTPError):
            super().log_exception(kind, value, trace)

    def put_json(self, content: Any) -> None:
        """Answer with JSON."""
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(_bytes(json_text(content)))

    def number(self, name: str) -> float:
        """Return a number of the query."""
        return _number(name, self.get_query_argument(name))


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name}: {text[:40]!r} is no number") from None


def _bytes(text: str) -> bytes:
    """Return encoded text; invalid bytes of a file name become escapes, which JSON allows."""
    return text.encode("utf-8", "backslashreplace")


class _Page(_Guarded):
    def refuse_stranger(self) -> None:
        self.set_status(401)
        self.finish(views.login("This workbench asks for its token, which the terminal shows."))

    def get(self) -> None:
        self.finish(views.page())


class _Login(_Guarded):
    open_to_all = True

    def post(self) -> None:
        token = self.get_body_argument("token", "")
        if not self.access.knows(token):
            self.set_status(401)
            self.finish(views.login("That is not the token."))
            return
        self.set_cookie(self.access.cookie, token, httponly=True, samesite="Strict")
        self.redirect("/", status=303)


class _Content(_Guarded):
    """The state of the page, and the numbers of its pictures."""

    async def get(self, name: str) -> None:
        self.put_json(await asyncio.to_thread(_CONTENT[name], self))


_CONTENT: dict[str, Callable[[_Content], Any]] = {
    "state": lambda own: views.state(own.session),
    "found": lambda own: pictures.found(own.session),
    "heard": lambda own: pictures.heard(own.session),
    "sample": lambda own: pictures.sample(own.session, own.get_query_argument("key"), own.number("time")),
    "motion": lambda own: pictures.motion(
        own.session, own.get_query_argument("key"), own.number("from"), own.number("until")
    ),
}


class _Events(_Guarded):
    """Sends the version of the state to a page at every change."""

    async def get(self) -> None:
        self.set_header("Content-Type", "text/event-stream")
        loop, changed = asyncio.get_running_loop(), asyncio.Event()

        def tell() -> None:
            loop.call_soon_threadsafe(changed.set)

        end = self.session.watch(tell)
        try:
            async for _ in _beats(changed):
                if self.session.closed:
                    return
                self.write(f"data: {self.session.version}\n\n")
                await self.flush()
        except StreamClosedError:
            pass
        finally:
            end()


async def _beats(changed: asyncio.Event) -> AsyncIterator[None]:
    yield
    while True:
        try:
            await asyncio.wait_for(changed.wait(), _BEAT)
            changed.clear()
        except TimeoutError:
            pass
        yield


class _Live(_Guarded):
    """Streams the signals of a running bench to a page, for as long as it listens."""

    async def get(self) -> None:
        key, live = self.get_query_argument("key"), self.session.live
        with live.watching(key) as trace:
            self.set_header("Content-Type", "text/event-stream")
            place, silent = -1, 0
            with contextlib.suppress(StreamClosedError):
                while not self.session.closed:
                    piece = trace.since(place)
                    silent = 0 if piece["rows"] else silent + 1
                    if piece["rows"] or silent % _BEAT_FRAMES == 1:  # a page that is gone is found by writing
                        start = live.runs[key].start_ns
                        piece["zero"] = start / SECOND if start >= 0 else None
                        self.write(f"data: {json.dumps(piece, separators=(',', ':'))}\n\n")
                        await self.flush()
                    place = piece["next"]
                    await asyncio.sleep(FRAME)


class _Signal(_Guarded):
    async def get(self) -> None:
        key, points = self.get_query_argument("key"), self.number("points")
        if not 0.0 < points < 1e6:
            raise InputError(f"points: {points:g}; allowed: 1 .. 1e6")
        first, last = self.number("from"), self.number("until")
        content = await asyncio.to_thread(pictures.signal, self.session, key, first, last, int(points))
        self.set_header("Content-Type", "application/octet-stream")
        self.finish(content)


class _Report(_Guarded):
    """The written report, to view and to save."""

    def get(self) -> None:
        if self.session.report is None:
            raise InputError("report: none is written on the latest diagnosis")
        self.set_header("Content-Security-Policy", f"{POLICY}; frame-ancestors 'none'")
        self.finish(_bytes(self.session.report))


@stream_request_body
class _Table(_Guarded):
    """A table of another program, written to disk as it arrives."""

    _file: BinaryIO | None = None
    _place: Path | None = None
    _failure: InputError | None = None  # while the request is still coming

    def prepare(self) -> None:
        super().prepare()
        if self._finished:
            return
        if self.request.headers.get("Content-Type", "") != "application/octet-stream":
            raise HTTPError(415, reason="only application/octet-stream is taken")
        self.request.connection.set_max_body_size(LARGEST_TABLE)  # type: ignore[union-attr]
        self._place = self.session.place_for(self.get_query_argument("name"))
        with disk_errors(self._place):
            self._file = self._place.open("wb", buffering=0)

    async def data_received(self, chunk: bytes) -> None:
        """Write a piece; after an error the rest of the request passes unread."""
        if self._file is not None and self._place is not None:
            try:
                with disk_errors(self._place):
                    await asyncio.to_thread(_write, self._file, chunk)
            except InputError as error:
                self._failure = error
                self._drop()

    async def post(self) -> None:
        """Read the complete table."""
        if self._failure is not None:
            raise self._failure
        if self._file is not None and self._place is not None:
            self._file.close()
            self._file = None
            await asyncio.to_thread(self.session.look, self._place)
        self.put_json({})

    def on_connection_close(self) -> None:
        """Remove an incomplete table."""
        self._drop()

    def _drop(self) -> None:
        if self._file is not None and self._place is not None:
            self._file.close()
            self._place.unlink(missing_ok=True)
            self._file = None


def _write(file: BinaryIO, chunk: bytes) -> None:
    """Write a piece completely: a file without a buffer may take less."""
    rest = memoryview(chunk)
    while rest:
        rest = rest[file.write(rest) :]


class _Preview(_Guarded):
    """The measured signals, as the map of the table reads them."""

    def get(self) -> None:
        if self.session.table is None or not self.session.table.picture:
            raise HTTPError(404)
        self.set_header("Content-Type", "image/png")
        self.finish(self.session.table.picture)


class _Flow(_Guarded):
    """The computed flow of the air around the rotor."""

    async def get(self, which: str) -> None:
        self.set_header("Content-Type", "image/png")
        self.finish(await asyncio.to_thread(pictures.flow, which))


class _Help(_Guarded):
    """The help page, and one page for each effect."""

    async def get(self, name: str | None = None) -> None:
        self.finish(
            await asyncio.to_thread(
                lambda: views.help_page() if name is None else views.effect_page(self.session, name)
            )
        )


class _Action(_Guarded):
    """An action of the user, as JSON."""

    async def post(self, name: str) -> None:
        if self.request.headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
            raise HTTPError(415, reason="only application/json is taken")
        try:
            given = json.loads(self.request.body)
        except (ValueError, RecursionError):
            raise InputError("request: is no JSON") from None
        if not isinstance(given, dict) or not all(isinstance(value, str) for value in given.values()):
            raise InputError("request: must be an object of texts")
        if any("\ud800" <= c <= "\udfff" for value in given.values() for c in value):
            raise InputError("request: halves of characters are no text")
        self.put_json(await asyncio.to_thread(self._do, name, given) or {})

    def _do(self, name: str, given: dict[str, str]) -> dict[str, Any] | None:
        session = self.session
        actions: dict[str, Callable[[], Any]] = {
            "open": lambda: session.open(given["key"], given["role"]),  # type: ignore[arg-type]
            "close": lambda: session.close(given["key"]),
            "use": lambda: session.use(
                given["key"],
                _number("from", given["from"]),
                _number("until", given["until"]),
                given["use"],  # type: ignore[arg-type]
            ),
            "use_all": lambda: session.use_all(given["key"]),
            "compare": session.compare,
            "follow": lambda: session.follow(given["key"]),
            "walk": lambda: session.walk(given["plan"], given["bench"]),
            "setpoint": lambda: {
                "said": session.setpoint(given["bench"], read_setpoint(given, _number), sure="sure" in given)
            },
            "other": lambda: session.other(given["name"]),
            "diagnose": session.diagnose,
            "add": lambda: session.add(given["what"]),
            "add_all": session.add_all,
            "estimate": session.estimate,
            "profile": lambda: session.profile(given["name"]),
            "remove": lambda: session.remove(given["what"]),
            "formula": lambda: _checked(lambda: views.formula(session, given["text"])),
            "derived": lambda: _checked(lambda: {"unit": channel(given["text"]).unit}),
            "derive": lambda: session.derive(given["text"]),
            "underive": lambda: session.underive(given["text"]),
            "region": lambda: windows.region(session, _numbers(given["windows"])),
            "orders": lambda: orders(session, given["channel"], _numbers(given["windows"])),
            "add_formula": lambda: session.add(given["text"], formula=True),
            "test": lambda: session.test(given["plan"], given.get("bench", "")),
            "map_table": lambda: session.map_table(given, take="take" in given),
            "drop_table": session.drop_table,
            "demonstrate": session.demonstrate,
            "report": session.write_report,
            "undo": session.undo,
            "redo": session.redo,
            "save": lambda: {"path": str(session.save(given["name"]))},
            "end": session.end,
        }
        if name not in actions:
            raise HTTPError(404)
        try:
            result: dict[str, Any] | None = actions[name]()
        except KeyError as error:
            raise InputError(f"request: {error.args[0]} is missing") from None
        return result


def _numbers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",") if part]
    except ValueError:
        raise InputError(f"windows: {text[:40]!r} are no numbers") from None


def _checked(read: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the parsed formula, or the reason why it is refused: a question is no error."""
    try:
        return read()
    except InputError as error:
        return {"refused": str(error)}


class _File(_Guarded):
    """Scripts and style."""

    def get(self, name: str) -> None:
        self.set_header("Content-Type", "text/css" if name.endswith(".css") else "text/javascript")
        if name == "page.css":
            self.finish(str(style_sheet()))
        elif name in _LIBRARY:
            self.set_header("Cache-Control", "max-age=86400")
            self.finish(_library(name))
        else:
            file = resources.files("gyrowheel.workbench").joinpath("files", name)
            if not file.is_file():
                raise HTTPError(404)
            self.finish(file.read_bytes())


def _library(name: str) -> bytes:
    from bokeh.util.paths import bokehjs_path

    return (Path(bokehjs_path()) / "js" / name).read_bytes()


def application(session: Session, access: Access) -> Application:
    """Return the pages and answers of the workbench."""
    rules: list[tuple[str, type[_Guarded]]] = [
        (r"/", _Page),
        (r"/login", _Login),
        (r"/(state|found|heard|sample|motion)", _Content),
        (r"/events", _Events),
        (r"/live", _Live),
        (r"/signal", _Signal),
        (r"/report", _Report),
        (r"/table", _Table),
        (r"/preview\.png", _Preview),
        (r"/flow/(axial|radial)\.png", _Flow),
        (r"/help", _Help),
        (r"/help/effect/([A-Za-z_0-9]{1,60})", _Help),
        (r"/do/([a-z_]+)", _Action),
        (r"/files/([a-z-]+(?:\.min)?\.(?:css|js))", _File),
    ]
    return Application(
        [(rule, handler, {"session": session, "access": access}) for rule, handler in rules],
        log_function=lambda handler: None,
        compress_response=False,
    )


class _Listening(socket.socket):
    """A listening socket; where no file descriptor is free, `relieve` closes a connection to get one."""

    relieve: Callable[[], bool]

    def accept(self) -> tuple[socket.socket, Any]:
        try:
            return super().accept()
        except OSError as error:
            if error.errno not in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                raise
            if not self.relieve():
                time.sleep(_NO_ROOM)  # the event loop would call again at once
            raise BlockingIOError from None


class _Connections(HTTPServer):
    """A server of a limited number of connections: the newest ones, as the page opens one whenever it needs it."""

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection, and close the oldest ones beyond the limit."""
        self._streams = [*self._open_streams(), stream]
        for own in self._streams[: -_most_connections()]:
            own.close()
        super().handle_stream(stream, address)

    def relieve(self) -> bool:
        """Close the oldest connection, if any, and return whether one was closed."""
        found = self._open_streams()
        for oldest in found[:1]:
            oldest.close()
        return bool(found)

    def _open_streams(self) -> list[IOStream]:
        return [own for own in getattr(self, "_streams", ()) if not own.closed()]


def _most_connections() -> int:
    """Return how many connections are open at most: half of the descriptors are for files."""
    return max(min(_MOST_CONNECTIONS, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 2), 4)


def _load() -> None:
    """Load the compiled reader of large recordings; its errors appear at the first of them."""
    with contextlib.suppress(Exception):
        load_loops()


def _is_every(address: str) -> bool:
    """Return whether an address stands for all addresses of this computer; OSError if it is unknown."""
    found = socket.getaddrinfo(address or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    places = (str(own[4][0]).partition("%")[0] for own in found)
    return any(ipaddress.ip_address(place).is_unspecified for place in places)


class Server:
    """The workbench on a port (0: any free one), in a thread, during a block.

    Any address but loopback requires a token; with `token` loopback does, too, which other users of the computer reach.
    InputError if address or port cannot be used, or the address is not a single one.
    """

    def __init__(
        self, session: Session, address: str = "127.0.0.1", port: int = 8080, *, token: bool = False
    ) -> None:
        self.session = session
        place = address.strip("[]")
        try:
            if _is_every(place):
                raise InputError(f"address: {address!r} is every address; name one of this computer")
            self._sockets = [
                _Listening(fileno=own.detach()) for own in bind_sockets(port, place, backlog=_BACKLOG)
            ]
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"port {port} of {address} cannot be used: {why}") from None
        self.port: int = self._sockets[0].getsockname()[1]
        self.access = Access.of(address, self.port, token=token)
        self._address = address
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        # while the user chooses a recording; joined at the end, since a compiler must not outlive its program
        self._loading = threading.Thread(target=_load)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{in_url(self._address)}:{self.port}/"

    def __enter__(self) -> Server:
        """Start the server."""
        self._thread.start()
        self._ready.wait(10.0)
        self._loading.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """End the server and its job."""
        self.session.shut()
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(10.0)
        self._loading.join()

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        server = _Connections(
            application(self.session, self.access),
            max_body_size=_LARGEST,
            max_buffer_size=2 * _LARGEST,
            idle_connection_timeout=_PATIENCE,
        )
        for own in self._sockets:
            own.relieve = server.relieve
        server.add_sockets(self._sockets)
        self._ready.set()
        await self._end.wait()
        server.stop()
        await asyncio.sleep(_PARTING)
        await server.close_all_connections()
