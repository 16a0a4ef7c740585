"""The server of the live view: who gets in, what it says, what it refuses."""

import http.client
import json
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.waiting import wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from eitbench.hardware.live import server
from eitbench.hardware.live.server import MAX_BYTES, MOST_VIEWERS, Access, access_to, listen
from eitbench.hardware.live.viewer import MOST_UNPAINTED
from eitbench.scenarios.errors import EitbenchError, InputError, UnreadableError
from eitbench.scenarios.recordings.files.recording_file import read_file

TOKEN = "correct-horse-battery"


def decoded(message: bytes) -> dict[str, Any]:
    """A live_image, read as the page does."""
    (length,) = struct.unpack("<I", message[:4])
    header: dict[str, Any] = json.loads(message[4 : 4 + length])
    assert length % 4 == 0
    values = np.frombuffer(message, "<f4", offset=4 + length)
    count = header["values"]
    pixels = int(np.prod(header["shape"])) if header["shape"] else 0
    header["image"] = values[:pixels].reshape(header["shape"]) if pixels else None
    header["voltages"] = values[pixels : pixels + count]
    header["untouched"] = values[pixels + count :] if header["reference"] else None
    assert len(values) == pixels + count * (1 + header["reference"])
    return header


def port_of(served: Any) -> int:
    return int(served.listening.getsockname()[1])


def get(served: Any, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port_of(served), timeout=10)
    headers = {"Host": f"127.0.0.1:{port_of(served)}"} | headers
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


@contextmanager
def page_of(served: Any, query: str = "", **options: Any) -> Iterator["Page"]:
    options = {"origin": f"http://127.0.0.1:{port_of(served)}"} | options
    with connect(f"ws://127.0.0.1:{port_of(served)}/ws{query}", **options) as socket:
        yield Page(socket)


class Page:
    """The WebSocket of a page in the browser."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket

    def ask(self, **command: Any) -> None:
        self.socket.send(json.dumps(command))

    def message(self, kind: str) -> dict[str, Any]:
        """The next message of a kind; images that come first are painted."""
        while True:
            received = self.socket.recv(timeout=20)
            if isinstance(received, bytes):
                self.ask(do="painted", number=decoded(received)["number"])
                continue
            message: dict[str, Any] = json.loads(received)
            if message["type"] == kind:
                return message

    def live_image(self, *, paint: bool = True) -> dict[str, Any]:
        """The next live_image."""
        while isinstance(received := self.socket.recv(timeout=20), str):
            pass
        live_image = decoded(received)
        if paint:
            self.ask(do="painted", number=live_image["number"])
        return live_image

    def image(self) -> dict[str, Any]:
        """The next live_image with an image."""
        while (live_image := self.live_image())["image"] is None:
            pass
        return live_image


def test_the_page_comes_with_all_it_needs_and_may_fetch_nothing(served: Any) -> None:
    response = get(served())
    html = response.read().decode()
    assert response.status == 200
    policy = response.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "connect-src 'self'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert "{{" not in html
    assert "src=" not in html
    assert response.headers["X-Content-Type-Options"] == "nosniff"


def test_a_live_image_holds_image_voltages_and_reference(served: Any, board: Any) -> None:
    with page_of(served()) as page:
        setup = page.message("setup")
        assert setup["sensor"] == "foam16"
        assert len(setup["electrodes_m"]) == 16
        offered = {method["name"] for method in setup["methods"]}
        assert {"noser", "tv", "dnn"} <= offered
        assert not {"linear-learned", "linear-touch"} & offered
        assert setup["scale"] == [0.05, 1.0]
        live_image = page.image()
        sent = board.sent[live_image["frame"]].values
        np.testing.assert_allclose(live_image["voltages"], sent, rtol=1e-6)
        reference = np.mean([frame.values for frame in board.sent[:10]], axis=0)
        np.testing.assert_allclose(live_image["untouched"], reference, rtol=1e-5, atol=1e-7)
        assert live_image["image"].shape == (80, 80)
        page.ask(do="touch", x_m=0.03, y_m=0.06, radius_m=0.008, pressure_pa=2e4)
        while not (live_image := page.live_image())["contacts"]:
            pass
        assert (
            np.hypot(
                live_image["contacts"][0]["x_m"] - 0.03, live_image["contacts"][0]["y_m"] - 0.06
            )
            < 0.005
        )
        row, column = np.unravel_index(live_image["image"].argmin(), (80, 80))
        assert abs(row / 80 - 0.6) < 0.1  # the row grows with y
        assert abs(column / 80 - 0.3) < 0.1
        page.ask(do="release")
        while page.live_image()["contacts"]:
            pass
        assert page.message("state")["latency_ms"] > 0


def test_a_page_is_told_how_old_its_image_is(served: Any) -> None:
    with page_of(served()) as page:
        assert page.message("state")["age_s"] is None
        while (age_s := page.message("state")["age_s"]) is None:
            pass
        assert 0 <= age_s < 20
        while not page.live_image(paint=False):
            pass
        for _ in range(6):  # it paints no more, and what it shows grows old
            while isinstance(received := page.socket.recv(timeout=20), bytes):
                pass
        assert json.loads(received)["age_s"] > 1


def test_a_page_that_goes_away_lets_go(served: Any, board: Any) -> None:
    one = served()
    untouched = board._clean
    with page_of(one) as page:
        page.ask(do="touch", x_m=0.03, y_m=0.06, radius_m=0.008, pressure_pa=2e4)
        wait_for(lambda: board._clean is not untouched)
    wait_for(lambda: board._clean is untouched)
    wait_for(lambda: not one.broadcast.viewers)


def test_a_page_that_paints_nothing_gets_no_more_images(served: Any) -> None:
    one = served()
    with page_of(one) as slow, page_of(one) as quick:
        quick.image()
        images = [slow.live_image(paint=False) for _ in range(MOST_UNPAINTED)]
        while (seen := quick.live_image()["frame"]) < images[-1]["frame"] + 20:
            pass
        for _ in range(3):  # what it still gets is how things stand
            assert isinstance(slow.socket.recv(timeout=20), str)
        slow.ask(do="painted", number=images[-1]["number"])
        assert slow.live_image()["frame"] >= seen


def test_commands_do_what_they_say(served: Any) -> None:
    with page_of(served()) as page:
        page.image()
        page.ask(do="method", name="tv")
        while page.image()["method"] != "tv":
            pass
        page.ask(do="record", on=True)
        while (state := page.message("state"))["recording"] is None or not state["recording"][
            "frames"
        ]:
            page.live_image()
        assert state["recording"]["running"]
        page.ask(do="record", on=False)
        while (state := page.message("state"))["recording"]["running"]:
            pass
        content, condition = read_file(Path(state["recording"]["file"]))
        assert len(content) == state["recording"]["frames"] > 0
        assert content.emulated
        assert condition.complete
        before = page.image()["untouched"]
        page.ask(do="reference")
        while (page.image()["untouched"] == before).all():
            pass


REFUSED: list[tuple[str | bytes, str]] = [
    ("", "Invalid JSON"),
    ("[]", "object"),
    ('{"do": "format-the-disk"}', "tag"),
    ('{"do": "record"}', "required"),
    ('{"do": "record", "on": "yes"}', "boolean"),
    ('{"do": "reference", "now": 1}', "not permitted"),
    ('{"do": "touch", "x_m": NaN, "y_m": 0, "radius_m": 0.01, "pressure_pa": 1}', "finite"),
    ('{"do": "touch", "x_m": 1e9, "y_m": 0, "radius_m": 0.01, "pressure_pa": 1}', "less than"),
    ('{"do": "method", "name": "nose"}', "did you mean 'noser'"),
    (b"\x00\x01", "Invalid JSON"),
]


def test_anything_else_is_refused_in_a_sentence(served: Any) -> None:
    with page_of(served()) as page:
        for message, why in REFUSED:
            page.socket.send(message)
            assert why in page.message("refused")["why"]
        page.ask(do="reference")  # and the page goes on
        assert page.message("state")


def test_a_message_that_is_too_long_ends_the_visit(served: Any) -> None:
    with page_of(served()) as page:
        page.socket.send("x" * (MAX_BYTES + 1))
        with pytest.raises(ConnectionClosed) as closed:
            page.message("farewell")
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


def test_only_so_many_pages_are_open(served: Any) -> None:
    one = served()
    with ExitStack() as pages:
        for _ in range(MOST_VIEWERS):
            pages.enter_context(page_of(one))
        wait_for(lambda: len(one.broadcast.viewers) == MOST_VIEWERS)
        with page_of(one) as late, pytest.raises(ConnectionClosed, match="pages are open already"):
            late.message("setup")
    wait_for(lambda: not one.broadcast.viewers)


def test_pages_from_elsewhere_are_refused(served: Any) -> None:
    one = served()
    origins: tuple[Any, ...] = (None, "http://evil.example", "http://127.0.0.1:1", "null")
    for origin in origins:
        with pytest.raises(InvalidStatus) as refused, page_of(one, origin=origin):
            pass
        assert refused.value.response.status_code == 403


def test_a_name_that_was_made_to_point_here_is_refused(served: Any) -> None:
    one = served()
    evil = f"evil.example:{port_of(one)}"
    assert get(one, Host=evil).status == 421
    assert get(one, Host="127.0.0.1:1").status == 421
    assert get(one, Host=f"localhost:{port_of(one)}").status == 200
    with (
        pytest.raises(InvalidStatus),
        page_of(one, origin=f"http://{evil}", additional_headers={"Host": evil}),
    ):
        pass


def test_with_a_token_nobody_else_gets_in(served: Any) -> None:
    one = served(Access("127.0.0.1", TOKEN))
    for wrong in ("", "?token=", "?token=wrong", "?token=%FF", "?token=%ED%A0%80", "?token=%00"):
        assert get(one, f"/{wrong}").status == 401
    assert get(one, Cookie="eitbench_live=\xff").status == 401
    welcome = get(one, f"/?token={TOKEN}")
    assert (welcome.status, welcome.headers["Location"]) == (303, "/")  # out of the address bar
    cookie = welcome.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "samesite=strict" in cookie.lower()
    given = cookie.split(";")[0]
    assert get(one, Cookie=given).status == 200
    for query, headers in (("", {}), ("?token=%FF", {}), ("", {"Cookie": given + "x"})):
        with (
            pytest.raises(InvalidStatus) as refused,
            page_of(one, query, additional_headers=headers),
        ):
            pass
        assert refused.value.response.status_code == 401
    for query, headers in ((f"?token={TOKEN}", {}), ("", {"Cookie": given})):
        with page_of(one, query, additional_headers=headers) as page:
            assert page.message("setup")["sensor"] == "foam16"


def test_with_a_token_addresses_are_ours_and_foreign_names_are_not() -> None:
    access = Access("0.0.0.0", TOKEN)
    assert access.is_ours("192.168.1.7:80", 80)
    assert access.is_ours("[fe80::1]:80", 80)
    assert access.is_ours("192.168.1.7", 80)
    assert not access.is_ours("evil.example:80", 80)
    assert not access.is_ours(None, 80)
    assert not Access().is_ours("192.168.1.7:80", 80)


def test_other_machines_need_host_and_token(tmp_path: Path) -> None:
    """The token comes from the environment or a file, which wins."""
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    assert access_to(None, None, TOKEN) == Access("127.0.0.1", "")
    assert access_to("0.0.0.0", None, TOKEN) == Access("0.0.0.0", TOKEN)
    assert access_to("0.0.0.0", file, "another-token-here") == Access("0.0.0.0", TOKEN)
    file.write_text(f"{TOKEN}\n", encoding="utf-8-sig")
    assert access_to("0.0.0.0", file, "another-token-here") == Access("0.0.0.0", TOKEN)
    with pytest.raises(InputError, match="EITBENCH_TOKEN, or in a file"):
        access_to("0.0.0.0", None, "")
    with pytest.raises(InputError, match="--host"):
        access_to(None, file, "")
    with pytest.raises(UnreadableError, match="Cannot read the token"):
        access_to("0.0.0.0", tmp_path, "")
    for weak in (
        "short",
        "with spaces in it, and more",
        "gr\u00fc\u00df-gott-und-servus",
        "\udcff" * 20,
    ):
        with pytest.raises(InputError, match="16 to 128"):
            access_to("0.0.0.0", None, weak)


HALF_OPEN = [
    b"",
    b"GET / HTTP/1.1\r\nHost: ",
    b"GET /favicon.ico HTTP/1.1\r\nHost: x\r\n\r\nGET / HTT",  # one whole request, and half of one
]


def test_a_connection_that_never_asks_is_closed(
    served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "HEADER_WITHIN_S", 0.3)
    one = served()
    with page_of(one) as page, ExitStack() as connections:
        page.message("state")
        for sent in HALF_OPEN:
            half_open = connections.enter_context(
                socket.create_connection(("127.0.0.1", port_of(one)), timeout=20)
            )
            half_open.sendall(sent)
            while half_open.recv(1 << 16):
                pass
        assert page.message("state")  # it was open for longer than all of them


def test_a_name_that_no_machine_has_is_said() -> None:
    with pytest.raises(InputError, match="is no address of this machine"):
        listen(Access("\u00e9..x", TOKEN), 0)


def test_a_port_that_is_taken_is_said() -> None:
    with listen(Access(), 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(EitbenchError, match=f"Cannot listen on 127.0.0.1, port {port}"):
            listen(Access(), port)
