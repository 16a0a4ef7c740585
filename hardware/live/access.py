"""Access to the live view: programs on this machine, or everybody who has the token."""

import hmac
import ipaddress
import re
import socket
from dataclasses import dataclass

from eitbench.scenarios.errors import InputError

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


def access_to(host: str | None, token: str | None) -> Access:
    """Return the access that the options `--host` and `--token` describe; both or none.

    Raises:
        InputError: one without the other, or a token that is too easily guessed.
    """
    if host is None and token is None:
        return Access()
    if token is None:
        raise InputError(
            f"--host {host} lets other machines look and press buttons: give them a --token, too, "
            "of at least 16 characters."
        )
    if host is None:
        raise InputError("--token is for other machines: say with --host where they connect.")
    if not _TOKEN.fullmatch(token):
        raise InputError("A token has 16 to 128 letters, digits, hyphens and underscores.")
    return Access(host, token)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
