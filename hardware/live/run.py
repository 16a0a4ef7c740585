"""A complete live view: a board, its session, and the server that shows it."""

import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import uvicorn

from eitbench.hardware.board import Board
from eitbench.hardware.live.server import Access, listen, make_server
from eitbench.hardware.live.session import Session
from eitbench.hardware.live.viewer import Broadcast
from eitbench.scenarios.errors import InputError


@dataclass(frozen=True, eq=False)
class LiveView:
    """A board that is watched, and a server that is yet to be run.

    Attributes:
        session: reads the board.
        broadcast: the pages that are open.
        address: of the page, with the token if there is one.
    """

    session: Session
    broadcast: Broadcast
    address: str
    server: uvicorn.Server
    listening: socket.socket

    def serve(self) -> None:
        """Answer pages until Ctrl-C, or until the server is stopped."""
        self.server.run(sockets=[self.listening])


@contextmanager
def live_view(
    board: Board,
    name: str,
    method: str,
    *,
    access: Access,
    port: int,
    out: Path,
    parameters: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Iterator[LiveView]:
    """A live view of `board`, called `name`; the board is closed at the end.

    Args:
        board: the board, not yet opened.
        name: registry name of the board.
        method: the first method that makes the images.
        access: address and token of the server.
        port: of the server; 0 takes any that is free.
        out: the folder that recordings go to; it is made if there is none.
        parameters: of the methods' constructors, by name; defaults of those that are not there.

    Raises:
        BoardError: the board cannot be opened.
        InputError: an unknown method, or one that cannot be used on the sensor; a folder that
            cannot be made.
        EitbenchError: the port is taken.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"The folder {out} cannot be made ({error.strerror}): name another with --out."
        ) from error
    broadcast = Broadcast(board.sensor)
    session = Session(board, name, out=out, show=broadcast.show, parameters=parameters)
    with listen(access, port) as listening:
        port = listening.getsockname()[1]
        server = make_server(session, broadcast, access, port)
        session.start(method)
        try:
            yield LiveView(session, broadcast, _address(access, port), server, listening)
        finally:
            session.stop()


def _address(access: Access, port: int) -> str:
    everywhere = access.host in ("0.0.0.0", "::")  # noqa: S104, it is only compared
    host = socket.gethostname() if everywhere else access.host
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}/" + (f"?token={access.token}" if access.token else "")
