"""The server of the live view: one page, and one WebSocket for each page that is open."""

import asyncio
import json
import socket

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from eitbench.hardware.live.access import Access
from eitbench.hardware.live.page import page
from eitbench.hardware.live.page_setup import page_setup
from eitbench.hardware.live.requests import (
    MAX_BYTES,
    ChooseMethod,
    PageRequest,
    Painted,
    Press,
    Record,
    Release,
    TakeReference,
    read_request,
)
from eitbench.hardware.live.session import Session
from eitbench.hardware.live.viewer import Broadcast, Viewer
from eitbench.scenarios.errors import EitbenchError

STATE_EVERY_S = 0.25
MOST_VIEWERS = 16
COOKIE = "eitbench_live"
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
    except OSError as error:
        raise EitbenchError(
            f"Cannot listen on {access.host}, port {port} ({error.strerror or error}): give "
            "another with --http-port."
        ) from error


def make_server(
    session: Session, broadcast: Broadcast, access: Access, port: int
) -> uvicorn.Server:
    """The server for `session`; run it with the socket that listens on `port`."""
    pages = _Pages(session, broadcast, access, port)
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
        )
    )


class _Pages:
    """Answers to visitors who have access; others are refused."""

    def __init__(self, session: Session, broadcast: Broadcast, access: Access, port: int) -> None:
        self._session = session
        self._broadcast = broadcast
        self._access = access
        self._port = port
        self._setup = page_setup(session)

    async def show_page(self, request: Request) -> Response:
        if not self._is_ours(request):
            return PlainTextResponse(
                "This is not the address of the live view: open the one that eitbench printed.", 421
            )
        given = request.query_params.get("token")
        if given is not None and self._access.has_token(given):
            # The token must not stay in the address, which browsers keep and show.
            answer = RedirectResponse("/", 303)
            answer.set_cookie(COOKIE, given, httponly=True, samesite="strict")
            return answer
        if not self._access.has_token(request.cookies.get(COOKIE)):
            return PlainTextResponse("Open the address with the token that eitbench printed.", 403)
        return HTMLResponse(
            page().html,
            headers={
                "Content-Security-Policy": page().policy,
                "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer",
                "Cross-Origin-Opener-Policy": "same-origin",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Cache-Control": "no-store",
            },
        )

    async def watch(self, websocket: WebSocket) -> None:
        if not self._may_connect(websocket):
            await websocket.close(_POLICY_VIOLATED)
            return
        await websocket.accept()
        if len(self._broadcast.viewers) >= MOST_VIEWERS:
            await websocket.close(_TRY_LATER, f"{MOST_VIEWERS} pages are open already.")
            return
        viewer = Viewer()
        self._broadcast.add(viewer)
        connection = _PageConnection(websocket, viewer, self._session, self._setup)
        tasks = [asyncio.create_task(work()) for work in (connection.send, connection.listen)]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._broadcast.viewers.discard(viewer)
            for task in tasks:
                task.cancel()
            for ended in await asyncio.gather(*tasks, return_exceptions=True):
                if isinstance(ended, Exception) and not isinstance(ended, WebSocketDisconnect):
                    raise ended

    def _is_ours(self, connection: HTTPConnection) -> bool:
        return self._access.is_ours(connection.headers.get("host"), self._port)

    def _may_connect(self, websocket: WebSocket) -> bool:
        """A foreign page may open a WebSocket to here, but cannot choose its own Origin."""
        headers = websocket.headers
        same_origin = headers.get("origin") == f"http://{headers.get('host')}"
        token = websocket.cookies.get(COOKIE) or websocket.query_params.get("token")
        return self._is_ours(websocket) and same_origin and self._access.has_token(token)


class _PageConnection:
    """The WebSocket of one open page."""

    def __init__(
        self, websocket: WebSocket, viewer: Viewer, session: Session, setup: dict[str, object]
    ) -> None:
        self._websocket = websocket
        self._viewer = viewer
        self._session = session
        self._setup = setup
        self._presses = False

    async def send(self) -> None:
        """Send the setup, then images as they come and the state four times a second."""
        await self._say("setup", self._setup)
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            if loop.time() >= due:
                seen = {"latency_ms": self._viewer.latency_ms, "age_s": self._viewer.age_s}
                await self._say("state", self._session.state() | seen)
                due = loop.time() + STATE_EVERY_S
            message = await self._viewer.next(due - loop.time())
            if message is not None:
                await self._websocket.send_bytes(message.data)

    async def listen(self) -> None:
        """Do what the page requests; send the reason if it cannot be done."""
        try:
            while (message := await self._websocket.receive())["type"] == "websocket.receive":
                try:
                    await self._do(read_request(message.get("text") or ""))
                except EitbenchError as error:
                    await self._say("refused", {"why": str(error)})
        finally:
            if self._presses:
                self._session.release()

    async def _say(self, kind: str, content: dict[str, object]) -> None:
        await self._websocket.send_text(json.dumps({"type": kind} | content, allow_nan=False))

    async def _do(self, request: PageRequest) -> None:
        session = self._session
        match request:
            case Painted():
                self._viewer.painted(request.number)
            case Press():
                self._presses = True
                session.touch(request.x_m, request.y_m, request.radius_m, request.pressure_pa)
            case Release():
                self._presses = False
                session.release()
            case ChooseMethod():
                await asyncio.to_thread(session.imaging.choose, request.name)
            case TakeReference():
                session.take_reference()
            case Record(on=True):
                await asyncio.to_thread(session.start_recording)
            case Record():
                await asyncio.to_thread(session.stop_recording)
