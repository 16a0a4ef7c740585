"""Serial ports: which there are, who may use them, and who has them."""

import contextlib
import errno
import os
from pathlib import Path

from serial.tools import list_ports

from eitbench.hardware.board import BoardError
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
        BoardError: it cannot be used; the sentence says why and what to do.
    """
    path = Path(port)
    if os.name != "posix":
        return
    if not path.exists():
        raise BoardError(f"There is no serial port {port}: {existing()}.")
    # On Linux, 1 is memory, such as /dev/null, which every other program uses.
    if not path.is_char_device() or os.major(path.stat().st_rdev) == 1:
        raise _no_serial_port(port)
    if not os.access(path, os.R_OK | os.W_OK):
        raise forbidden(port)
    if holders(port):
        raise taken(port)


def refused(port: str, error: OSError) -> BoardError:
    """The error of a port that could not be opened because of `error`."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return forbidden(port)
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return taken(port)
    if str(error).startswith("Could not configure port"):  # pyserial's; it has no rate to set
        return _no_serial_port(port)
    reason = os.strerror(error.errno) if error.errno else str(error)
    return BoardError(f"The serial port {port} cannot be opened ({reason}): {existing()}.")


def _no_serial_port(port: str) -> BoardError:
    return BoardError(f"{port!r} is no serial port: {existing()}.")


def forbidden(port: str) -> BoardError:
    """The error of a port that the user may not use; it names the group that may."""
    import grp  # only POSIX has groups

    stat = Path(port).stat()
    if stat.st_mode & 0o060 != 0o060:
        return BoardError(
            f"You may not use {port}, nor may any group: ask the administrator of this machine."
        )
    try:
        group = grp.getgrgid(stat.st_gid).gr_name
    except KeyError:
        group = str(stat.st_gid)
    return BoardError(
        f"You may not use {port}, which belongs to the group {group!r}: join it with `sudo "
        f"usermod -aG {group} $USER`, then log out and in again."
    )


def taken(port: str) -> BoardError:
    """The error of a port that is in use; it names the program if the system tells."""
    programs = ", ".join(holders(port)) or "another program"
    return BoardError(f"{port} is in use by {programs}: close it there first.")


def holders(port: str) -> list[str]:
    """The other programs that have `port` open, such as "minicom (process 4711)".

    Only Linux tells, and of other users' programs only to the administrator.
    """
    device = os.path.realpath(port)
    found = []
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
    except OSError:  # closed meanwhile
        return False
