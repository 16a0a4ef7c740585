"""Serial ports: which there are, who may use them, and who has them."""

import contextlib
import errno
import os
from pathlib import Path

from serial.tools import list_ports

from eitbench.hardware.board import BoardError, BoardLostError
from eitbench.scenarios.errors import InputError


def ports() -> list[str]:
    """The serial ports of this machine, such as "/dev/ttyACM0 (Teensyduino)"."""
    found = sorted(list_ports.comports(), key=lambda port: port.device)
    return [
        port.device + (f" ({port.description})" if port.description not in (None, "n/a") else "")
        for port in found
    ]


def existing() -> str:
    """Sentence that lists the ports of this machine."""
    listed = ", ".join(ports())
    return f"those that exist are {listed}" if listed else "there is none on this machine"


def no_port(board: str) -> InputError:
    """The error of a board that needs a port and was given none."""
    return InputError(f"Board {board!r} needs a serial port, and {existing()}: give --port.")


def check(port: str) -> None:
    """See that `port` exists, may be used, and is used by no other program.

    Raises:
        BoardError: it cannot be used, or (`BoardLostError`) is not there; the sentence says why
            and what to do.
    """
    path = Path(port)
    if os.name != "posix":
        return
    if not path.exists():
        raise BoardLostError(
            f"There is no serial port {port}: plug the board in, or name another; {existing()}."
        )
    # On Linux, 1 is memory, such as /dev/null, which every other program uses.
    if not path.is_char_device() or os.major(path.stat().st_rdev) == 1:
        raise BoardError(f"{port!r} is no serial port: {existing()}.")
    if not os.access(path, os.R_OK | os.W_OK, effective_ids=True):
        try:
            group = path.group()
        except KeyError:  # it has a number only
            group = str(path.stat().st_gid)
        raise BoardError(
            f"You may not use {port}: join its group with `sudo usermod -aG {group} $USER`, then "
            "log out and in again, or ask the administrator of this machine."
        )
    if holders(port):
        raise _taken(port)


def refused(port: str, error: OSError) -> BoardError:
    """The error of a port that could not be opened because of `error`."""
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return _taken(port)
    reason = os.strerror(error.errno) if error.errno else str(error)
    gone = os.name != "posix" and port not in ports()  # elsewhere `check` has seen that
    kind = BoardLostError if gone else BoardError
    return kind(f"The serial port {port} cannot be opened ({reason}): {existing()}.")


def _taken(port: str) -> BoardError:
    """The error of a port that is in use; it names the program if the system tells."""
    programs = ", ".join(holders(port)) or "another program"
    return BoardError(f"{port} is in use by {programs}: close it there first.")


def holders(port: str) -> list[str]:
    """The other programs that have `port` open, such as "minicom (process 4711)".

    Only Linux tells, and of other users' programs only to the administrator.
    """
    device, found = os.path.realpath(port), list[str]()
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        with contextlib.suppress(OSError):  # it has ended, or belongs to somebody else
            if any(_leads_to(link, device) for link in (process / "fd").iterdir()):
                name = (process / "comm").read_text().strip()
                found.append(f"{name} (process {process.name})")
    return found


def _leads_to(link: Path, device: str) -> bool:
    try:
        return str(link.readlink()) == device
    except OSError:  # it was closed meanwhile
        return False
