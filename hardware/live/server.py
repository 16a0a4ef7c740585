"""The server of the live view: one page, and one WebSocket for each page that is open.

Visitors are programs on this machine, or everybody who has the token. Requests of a page are small
JSON messages; everything else is refused.
"""

import asyncio
import hmac
import ipaddress
import json
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import uvicorn
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from eitbench.hardware.live.page import page, page_setup
from eitbench.hardware.live.session import Session
from eitbench.hardware.live.viewer import Broadcast, Viewer
from eitbench.scenarios.errors import EitbenchError, InputError, UnreadableError

LOCAL = "127.0.0.1"
_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")


@dataclass(frozen=True)
class Access:
    """Address and token of the server.

    Attributes:
        host: the address it listens on.
        token: shared secret of the visitors; "" if only this machine can connect.
    """

    host: str = LOCAL
    token: str = ""

    def has_token(self, given: str | None) -> bool:
        """True if `given` is the token; takes a time that does not depend on it."""
        return not self.token or hmac.compare_digest((given or "").encode(), self.token.encode())

    def is_ours(self, host: str | None, port: int) -> bool:
        """True if a request's Host header names this server.

        A foreign page may make its own name point here (DNS rebinding); its name is none of ours.
        """
        name, _, given_port = (host or "").rpartition(":")
        if not name:
            name, given_port = host or "", "80"
        if given_port != str(port):
            return False
        name = name.strip("[]").lower()
        if name in {LOCAL, "localhost", "::1"}:
            return True
        if not self.token:
            return False
        return name in {self.host.lower(), socket.gethostname().lower()} or _is_address(name)


def access_to(host: str | None, token_file: Path | None, token: str) -> Access:
    """Return the access that `--host` and the token of other machines describe.

    The token is in `token_file`, else in `token` ("" for none); a command line would show it to
    every user of this machine.

    Raises:
        InputError: a host without a token, a file of a token without a host, or a token that is
            too easily guessed.
        UnreadableError: the file cannot be read.
    """
    if host is None:
        if token_file is not None:
            raise InputError(
                "--token-file is for pages on other machines: let them connect with --host."
            )
        return Access()
    if token_file is not None:
        try:
            token = token_file.read_text(encoding="utf-8-sig", errors="replace").strip()
        except OSError as error:
            raise UnreadableError(
                f"Cannot read the token {token_file}: {error.strerror}."
            ) from error
    if not token:
        raise InputError(
            f"--host {host} lets other machines look and press buttons: set a token of at least "
            "16 characters in EITBENCH_TOKEN, or in a file that you name with --token-file."
        )
    if not _TOKEN.fullmatch(token):
        raise InputError("A token has 16 to 128 letters, digits, hyphens and underscores.")
    return Access(host, token)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


MAX_BYTES = 4096


class _PageRequest(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Painted(_PageRequest):
    """A live image is on the canvas."""

    do: Literal["painted"]
    number: int


class ChooseMethod(_PageRequest):
    """Use another method."""

    do: Literal["method"]
    name: Annotated[str, Field(max_length=80)]


class TakeReference(_PageRequest):
    """Take the next frames as reference frames."""

    do: Literal["reference"]


class Record(_PageRequest):
    """Begin or end a recording."""

    do: Literal["record"]
    on: bool


class Press(_PageRequest):
    """Press an emulated sensor at a place [m]; say where a real one is touched."""

    do: Literal["touch"]
    x_m: Annotated[float, Field(ge=-10, le=10)]
    y_m: Annotated[float, Field(ge=-10, le=10)]
    radius_m: Annotated[float, Field(gt=0, le=1)]
    pressure_pa: Annotated[float, Field(gt=0, le=1e6)] | None = None


class Release(_PageRequest):
    """End the touch."""

    do: Literal["release"]


PageRequest = Painted | ChooseMethod | TakeReference | Record | Press | Release
_ANY: TypeAdapter[PageRequest] = TypeAdapter(Annotated[PageRequest, Field(discriminator="do")])


def read_request(text: str) -> PageRequest:
    """Return the request in a message.

    Raises:
        InputError: it holds no request.
    """
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        raise InputError(f"This is no request of the live view: {first['msg']}.") from error


STATE_EVERY_S = 0.25
MOST_VIEWERS = 16
COOKIE = "eitbench_live"
HEADER_WITHIN_S = 10.0
"""Time that a visitor has for the header of a request [s]."""
_STOP_WITHIN_S = 2
_POLICY_VIOLATED, _TRY_LATER = 1008, 1013  # WebSocket close codes (RFC 6455, IANA)


def listen(access: Access, port: int) -> socket.socket:
    """A socket that listens where `access` says; port 0 takes any that is free.

    Raises:
        EitbenchError: the port is taken, or the address is none of this machine's.
    """
    family = socket.AF_INET6 if ":" in access.host else socket.AF_INET
    try:
        return socket.create_server((access.host, port), family=family)
    except TypeError as error:  # Python's for a text that can name no machine
        raise InputError(
            f"{access.host!r} is no address of this machine: give another with --host."
        ) from error
    except OSError as error:
        raise EitbenchError(
            f"Cannot listen on {access.host}, port {port} ({error.strerror or error}): give "
            "another with --http-port."
        ) from error


def make_server(
    session: Session, broadcast: Broadcast, access: Access, port: int
) -> uvicorn.Server:
    """The server for `session`; run it with the socket that listens on `port`."""
    pages = _Pages(session, broadcast, access, port, page_setup(session))
    app = Starlette(
        routes=[
            Route("/", pages.show_page, methods=["GET"]),
            WebSocketRoute("/ws", pages.watch),
        ]
    )
    return uvicorn.Server(
        uvicorn.Config(
            app,
            log_level="error",
            access_log=False,
            server_header=False,
            # Images hardly shrink, and shrinking them would take longer than sending them.
            ws_per_message_deflate=False,
            ws_max_size=MAX_BYTES,
            timeout_graceful_shutdown=_STOP_WITHIN_S,
            http=_RequestsInTime,
        )
    )


class _RequestsInTime(H11Protocol):
    """HTTP that closes a connection where no whole request header comes in time.

    uvicorn's own limit ends with the first byte of a header, so that one that is never finished
    would hold its connection for ever.
    """

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._expect_header()

    def on_response_complete(self) -> None:
        self._expect_header()
        super().on_response_complete()  # which begins with a request that waits already

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._expect_nothing()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        self._expect_nothing()
        super().connection_lost(exc)

    def _expect_header(self) -> None:
        self._expect_nothing()
        self._late = self.loop.call_later(HEADER_WITHIN_S, self._close_without, self.cycle)

    def _expect_nothing(self) -> None:
        if self._late is not None:
            self._late.cancel()

    def _close_without(self, before: object) -> None:
        if self.cycle is before:  # no request came since
            self.transport.close()


@dataclass(frozen=True)
class _Pages:
    """Answers to visitors who have access; others are refused."""

    session: Session
    broadcast: Broadcast
    access: Access
    port: int
    setup: dict[str, object]

    async def show_page(self, request: Request) -> Response:
        if not self._is_ours(request):
            return PlainTextResponse(
                "This is not the address of the live view: open the one that eitbench printed.", 421
            )
        given = request.query_params.get("token")
        if given is not None and self.access.has_token(given):
            # The token must not stay in the address, which browsers keep and show.
            answer = RedirectResponse("/", 303)
            answer.set_cookie(COOKIE, given, httponly=True, samesite="strict")
            return answer
        if not self.access.has_token(request.cookies.get(COOKIE)):
            return _no_token()
        html, policy = page()
        return HTMLResponse(
            html,
            headers={
                "Content-Security-Policy": policy,
                "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer",
                "Cross-Origin-Opener-Policy": "same-origin",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Cache-Control": "no-store",
            },
        )

    async def watch(self, websocket: WebSocket) -> None:
        if not self._is_same_origin(websocket):
            await websocket.close(_POLICY_VIOLATED)
            return
        token = websocket.cookies.get(COOKIE) or websocket.query_params.get("token")
        if not self.access.has_token(token):
            await websocket.send_denial_response(_no_token())
            return
        await websocket.accept()
        if len(self.broadcast.viewers) >= MOST_VIEWERS:
            await websocket.close(_TRY_LATER, f"{MOST_VIEWERS} pages are open already.")
            return
        viewer = Viewer()
        self.broadcast.add(viewer)
        connection = _PageConnection(websocket, viewer, self.session, self.setup)
        tasks = [asyncio.create_task(work()) for work in (connection.send, connection.listen)]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.broadcast.viewers.discard(viewer)
            for task in tasks:
                task.cancel()
            for ended in await asyncio.gather(*tasks, return_exceptions=True):
                if isinstance(ended, Exception) and not isinstance(ended, WebSocketDisconnect):
                    raise ended

    def _is_ours(self, connection: HTTPConnection) -> bool:
        return self.access.is_ours(connection.headers.get("host"), self.port)

    def _is_same_origin(self, websocket: WebSocket) -> bool:
        """A foreign page may open a WebSocket to here, but cannot choose its own Origin."""
        headers = websocket.headers
        same_origin = headers.get("origin") == f"http://{headers.get('host')}"
        return self._is_ours(websocket) and same_origin


def _no_token() -> Response:
    return PlainTextResponse("Open the address with the token that eitbench printed.", 401)


@dataclass
class _PageConnection:
    """The WebSocket of one open page."""

    websocket: WebSocket
    viewer: Viewer
    session: Session
    setup: dict[str, object]
    presses: bool = False

    async def send(self) -> None:
        """Send the setup, then images as they come and the state four times a second."""
        await self._say("setup", self.setup)
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            if loop.time() >= due:
                seen = {"latency_ms": self.viewer.latency_ms, "age_s": self.viewer.age_s}
                await self._say("state", self.session.state() | seen)
                due = loop.time() + STATE_EVERY_S
            message = await self.viewer.next(due - loop.time())
            if message is not None:
                await self.websocket.send_bytes(message.data)

    async def listen(self) -> None:
        """Do what the page requests; send the reason if it cannot be done."""
        try:
            while (message := await self.websocket.receive())["type"] == "websocket.receive":
                try:
                    await self._do(read_request(message.get("text") or ""))
                except EitbenchError as error:
                    await self._say("refused", {"why": str(error)})
        finally:
            if self.presses:
                self.session.release()

    async def _say(self, kind: str, content: dict[str, object]) -> None:
        await self.websocket.send_text(json.dumps({"type": kind} | content, allow_nan=False))

    async def _do(self, request: PageRequest) -> None:
        session = self.session
        match request:
            case Painted():
                self.viewer.painted(request.number)
            case Press():
                self.presses = True
                session.touch(request.x_m, request.y_m, request.radius_m, request.pressure_pa)
            case Release():
                self.presses = False
                session.release()
            case ChooseMethod():
                await asyncio.to_thread(session.imaging.choose, request.name)
            case TakeReference():
                session.take_reference()
            case Record(on=True):
                await asyncio.to_thread(session.start_recording)
            case Record():
                await asyncio.to_thread(session.stop_recording)
