"""Requests that are not the page's own are refused, and none leads out of the study and its results."""

import asyncio
import contextlib
import json
import socket
import threading
import time
from pathlib import Path

import pytest
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from calib import workbench
from calib.workbench import server
from calib.workbench.guard import LARGEST, POLICY

from .conftest import OWN, PORT, TOKEN

SOCKET = f"ws://127.0.0.1:{PORT}"
JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def standing(compared, page_of):
    """One page for all requests that must change nothing, and the key of its study."""
    with contextlib.chdir(compared):
        opened = page_of(Path("mast"))
        yield opened, opened.get("studies").json()["studies"][0]["key"]


# Method, path after the token, further headers, body, and the status of the refusal.
FOREIGN = {
    "a host of another name": ("GET", "studies", {"host": "calib.example"}, None, 421),
    "another name for this computer": ("GET", "studies", {"host": f"rebound.example:{PORT}"}, None, 421),
    "another port": ("GET", "studies", {"host": "127.0.0.1:1"}, None, 421),
    "no host": ("GET", "studies", {"host": ""}, None, 421),
    "an address that begins with the host": ("GET", "studies", {"host": f"127.0.0.1:{PORT}.example"}, None, 421),
    "another origin that reads": ("GET", "studies", {"origin": "http://example.org"}, None, 403),
    "another origin that changes": ("POST", "study/KEY/run", {"origin": "http://example.org", **JSON}, b"{}", 403),
    "the origin of another port": ("POST", "study/KEY/run", {"origin": "http://127.0.0.1:1", **JSON}, b"{}", 403),
    "an encrypted origin": ("POST", "study/KEY/run", {"origin": f"https://127.0.0.1:{PORT}", **JSON}, b"{}", 403),
    "an origin without a name": ("POST", "study/KEY/run", {"origin": "null", **JSON}, b"{}", 403),
    "another site": ("GET", "studies", {"sec-fetch-site": "cross-site"}, None, 403),
    "another service of this computer": ("GET", "studies", {"sec-fetch-site": "same-site"}, None, 403),
    "a form": ("POST", "study/KEY/run", {"content-type": "application/x-www-form-urlencoded"}, b"verb=run", 415),
    "plain text": ("POST", "study/KEY/run", {"content-type": "text/plain"}, b'{"verb": "run"}', 415),
    "no type": ("POST", "study/KEY/run", {}, b"{}", 415),
    "a change by reading": ("GET", "study/KEY/run", {}, None, 405),
    "a change of another method": ("PUT", "study/KEY/run", JSON, b"{}", 405),
    "a deletion": ("DELETE", "study/KEY", JSON, b"", 405),
    "a question for what is allowed": ("OPTIONS", "study/KEY/run", JSON, b"", 405),
    "a trace": ("TRACE", "studies", JSON, b"", 405),
    "a body that is too long": ("POST", "study/KEY/run", JSON, b" " * (LARGEST + 1), 413),
    "a body that states no number": ("POST", "study/KEY/run", {**JSON, "content-length": "-5"}, b"{}", 413),
    "no JSON": ("POST", "study/KEY/run", JSON, b"{verb", 400),
    "JSON that is no object": ("POST", "study/KEY/run", JSON, b"[1]", 400),
    "JSON without end": ("POST", "study/KEY/run", JSON, b"[" * 60_000, 400),
    "a study that is not there": ("GET", "study/000000000000", {}, None, 404),
    "a path for a study": ("GET", "study/..%2f..%2fsecret.csv", {}, None, 404),
    "a path for a figure": ("GET", "study/KEY/figure/..%2f..%2fsecret", {}, None, 404),
    "a path for a file of the page": ("GET", "page/..%2f..%2f__init__.py", {}, None, 404),
    "a file beside the page": ("GET", "page/app.py", {}, None, 404),
    "a path above the token": ("GET", "../../../etc/passwd", {}, None, 403),
    "a command that the page does not have": ("POST", "study/KEY/run", JSON, b'{"verb": "new"}', 409),
    "a command with words in it": ("POST", "study/KEY/run", JSON, b'{"verb": "run; touch here"}', 409),
    "an option that it does not give": ("POST", "study/KEY/run", JSON, b'{"verb": "run", "options": {"into": 1}}', 409),
    "an option in the place of a value": (
        "POST", "study/KEY/run", JSON, b'{"verb": "calibrate", "options": {"case": "--results=/"}}', 409,
    ),
    "options that are none": ("POST", "study/KEY/run", JSON, b'{"verb": "run", "options": [1]}', 409),
    "an effect that nobody lists": ("POST", "study/KEY/add", JSON, b'{"effects": ["--into"]}', 409),
    "a process that is no command": ("POST", "study/KEY/stop", JSON, b'{"pid": 1}', 404),
    "a new study above the folder": ("POST", "new", JSON, b'{"name": "../new", "kind": ""}', 409),
    "a new study by reading": ("GET", "new", {}, None, 405),
    "a process without a number": ("POST", "study/KEY/stop", JSON, b'{"pid": "1"}', 404),
}  # fmt: skip


@pytest.mark.parametrize("asked", FOREIGN.values(), ids=FOREIGN)
def test_a_hostile_request_is_refused(standing, asked, monkeypatch):
    (page, key), (method, path, headers, body, status) = standing, asked
    monkeypatch.setattr("subprocess.Popen", lambda *given, **more: pytest.fail("a command was started"))
    found = page.request(method, f"{OWN}/{TOKEN}/{path.replace('KEY', key)}", headers=headers, content=body)
    assert found.status_code == status
    assert "SECRET" not in found.text and found.headers["content-security-policy"] == POLICY


@pytest.mark.parametrize("token", ["", "another", TOKEN[:-1], f"{TOKEN}x", TOKEN.upper(), "%00", "é"])
def test_a_wrong_token_is_refused(standing, token):
    page, _ = standing
    assert page.get(f"{OWN}/{token}/studies").status_code == 403
    with (
        pytest.raises((WebSocketDisconnect, WebSocketDenialResponse)),
        page.websocket_connect(f"{SOCKET}/{token}/live"),
    ):
        pass


@pytest.mark.parametrize("headers", [{"origin": "http://example.org"}, {"host": "example.org"}, {"origin": ""}])
def test_a_foreign_socket_is_refused(standing, headers):
    page, _ = standing
    with (
        pytest.raises((WebSocketDisconnect, WebSocketDenialResponse)),
        page.websocket_connect(f"{SOCKET}/{TOKEN}/live", headers=headers),
    ):
        pass


@pytest.mark.medium
def test_a_link_that_leads_out_of_the_results_counts_as_missing(page, key, here):
    table = here / "results/mast/mac_before.csv"
    drawn = f"study/{key}/figure/mac_before"
    page_before = page.get(drawn)
    assert page_before.status_code == 200 and "SECRET" not in page_before.text
    table.unlink()
    table.symlink_to(here / "secret.csv")
    (here / "results/mast/written.sha256").touch()
    assert page.get(drawn).status_code == 404


def test_a_study_that_is_a_link_out_of_the_folder_is_not_listed(here, page_of, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/study.toml").write_text((here / "mast/study.toml").read_text())
    (here / "linked").symlink_to(tmp_path / "elsewhere")
    (here / "file").mkdir()
    (here / "file/study.toml").symlink_to(tmp_path / "elsewhere/study.toml")
    assert [one["name"] for one in page_of(Path(".")).get("studies").json()["studies"]] == ["mast"]


def test_names_that_are_markup_stay_text(here, page_of):
    file = here / "mast/study.toml"
    evil = "<script>alert(1)</script>"
    file.write_text(file.read_text().replace("Example: a mast with an antenna", evil))
    page = page_of(Path("mast"))
    assert page.get("studies").json()["studies"][0]["title"] == evil  # as data, which the page sets as text
    scripts = [file.name for file in Path(workbench.__file__).with_name("page").glob("*.js")]
    files = [page.get("").text, *(page.get(f"page/{name}").text for name in scripts)]
    assert len(files) > 5
    assert not any("innerHTML" in text or "insertAdjacentHTML" in text or "document.write" in text for text in files)
    assert "<script>" not in files[0]  # all of them are files


def test_the_policy_lets_no_script_in_that_is_not_a_file(page):
    found = page.get("")
    rules = dict(rule.split(" ", 1) for rule in found.headers["content-security-policy"].split("; "))
    assert rules["script-src"] == "'self'" and rules["default-src"] == "'none'" and rules["connect-src"] == "'self'"
    assert found.headers["referrer-policy"] == "no-referrer" and found.headers["cache-control"] == "no-store"


@pytest.mark.slow
def test_a_body_that_does_not_come_is_given_up(here, monkeypatch):
    """By a socket of the real server, which other requests do not wait for."""
    uvicorn = pytest.importorskip("uvicorn")
    from calib.workbench.server import application

    monkeypatch.setattr("calib.workbench.guard.PATIENCE", 0.3)
    with socket.socket() as ears:
        ears.bind(("127.0.0.1", 0))
        port = ears.getsockname()[1]
        app = application(Path("mast"), Path("results"), TOKEN, port)
        server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [ears]})
        thread.start()
        while not server.started:
            time.sleep(0.01)
        host = f"Host: 127.0.0.1:{port}\r\n"
        head = f"POST /{TOKEN}/study/x/run HTTP/1.1\r\n{host}Origin: http://127.0.0.1:{port}\r\n"
        try:
            with (
                socket.create_connection(("127.0.0.1", port)) as slow,
                socket.create_connection(("127.0.0.1", port)) as quick,
            ):
                slow.sendall(f"{head}Content-Type: application/json\r\nContent-Length: 20\r\n\r\n{{".encode())
                quick.sendall(f"GET /{TOKEN}/studies HTTP/1.1\r\n{host}\r\n".encode())
                assert quick.recv(100).startswith(b"HTTP/1.1 200")
                assert slow.recv(100).startswith(b"HTTP/1.1 408")
        finally:
            server.should_exit = True
            thread.join()


def test_the_report_is_shown_where_it_can_ask_nothing(page, key, here):
    report = here / "results/mast/report.html"
    assert page.get(f"study/{key}/report").status_code == 404
    report.write_text("<script>1</script>")
    found = page.get(f"study/{key}/report")
    assert found.status_code == 200 and "sandbox" in found.headers["content-security-policy"]
    assert "allow-same-origin" not in found.headers["content-security-policy"]
    owner = here / "results/mast/owner.json"
    known = owner.read_bytes()
    owner.write_text(json.dumps({"study": "/elsewhere/mast/study.toml", "from_here": ""}))
    assert page.get(f"study/{key}/report").status_code == 404  # that of another study
    assert page.get(f"study/{key}").json()["report"] is False
    owner.write_bytes(known)
    report.unlink()
    report.symlink_to(here / "mast/study.toml")
    assert page.get(f"study/{key}/report").status_code == 404


@pytest.mark.medium
def test_nothing_that_is_asked_changes_a_file(page, key, here):
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    for what in ("", "/search", "/missing", "/versions", "/scene", "/figure/mac_before", "/figure/comparison"):
        assert page.get(f"study/{key}{what}").status_code == 200, what
    with page.websocket_connect(f"{SOCKET}/{TOKEN}/live") as live:
        assert key in json.loads(live.receive_text())["studies"]
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


def test_an_answer_does_not_wait_for_the_page():
    """Nagle's algorithm holds a body back until the page has acknowledged the head, some 40 ms later."""

    async def option():
        found = asyncio.get_running_loop().create_future()
        ears = server._listening(0)
        async with await asyncio.start_server(lambda _, own: found.set_result(own), sock=ears):
            _, mine = await asyncio.open_connection(*ears.getsockname())
            own = await found
            value = own.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            own.close()
            mine.close()
            return value

    assert asyncio.run(option())
