"""`eitbench live`, from a board to a page."""

import socket
from collections.abc import Callable
from pathlib import Path

from eitbench.hardware.board import Board
from eitbench.hardware.live.access import Access
from eitbench.hardware.live.recording import MakeRecorder
from eitbench.hardware.live.server import listen, make_server
from eitbench.hardware.live.session import Session
from eitbench.hardware.live.viewer import Gallery


def watch(
    board: Board,
    name: str,
    method: str,
    *,
    access: Access,
    port: int,
    out: Path,
    make_recorder: MakeRecorder,
    ready: Callable[[str], None],
) -> None:
    """Serve the live view of `board` until Ctrl-C; `ready` is told its address.

    Raises:
        BoardError: the board cannot be opened.
        InputError: an unknown method, or one without weights for the sensor.
        EitbenchError: the port is taken.
    """
    gallery = Gallery(board.sensor)
    session = Session(board, name, out=out, make_recorder=make_recorder, show=gallery.show)
    with listen(access, port) as listening:
        port = listening.getsockname()[1]
        session.start(method)
        try:
            ready(_address(access, port))
            make_server(session, gallery, access, port).run(sockets=[listening])
        except KeyboardInterrupt:
            pass  # how it ends
        finally:
            session.stop()


def _address(access: Access, port: int) -> str:
    host = socket.gethostname() if access.host in ("0.0.0.0", "::") else access.host
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}/" + (f"?token={access.token}" if access.token else "")
