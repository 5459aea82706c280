"""The page's server: its answers, refusals and stored state."""

import asyncio
import json
import os
import random
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from cpam_bayes.workbench import plate_text
from cpam_bayes.workbench.plate_text import FIELDS, with_file, with_sensors, with_value
from cpam_bayes.workbench.server import application
from cpam_bayes.workbench.view import folder_news
from cpam_bayes.workbench.visit import DRAFTS, Work
from cpam_bayes.workbench.worker import Shown, Worker
from tests.quick_page import EXAMPLE, desk_of, echo

TOKEN, PORT = "the-token-of-this-page", 8377
HERE = f"http://127.0.0.1:{PORT}"
POSTED, JSON = {"Origin": HERE}, {"Content-Type": "application/json"}
HOSTILE = (  # Values of a hostile request in place of a name, a path, a number or a list.
    "../secret.toml", "..%2fsecret.toml", "/etc/passwd", "link.toml", "a/../../secret.toml", "panel.toml\0",
    "x" * 30_000, "\\\\host\\share.toml", ".toml", "", None, -1, 1e308, [], {}, [[[]]], True,
    "<script>alert(1)</script>", "\x1b[2J", "C:panel.toml",
)  # fmt: skip
HOSTS = ("evil.example", "127.0.0.1:80", "127.0.0.1.evil.example:8377", "[::1]:8377", "")
ORIGINS = ("http://evil.example", "null", "https://127.0.0.1:8377", "http://127.0.0.1:80")
BODIES = (b"[" * 70_000, b'{"do": "set"}' + b" " * 70_000, b"\xff\xfe", b"[" * 5000, b'"x"')
PANEL = (Path(__file__).parents[2] / "examples" / "panel.toml").read_text("utf-8")
NUMBERS = [
    *((typed, typed) for typed in ("abc", "1e", "--2", "0x10", '"', "nan", "1 2", "[", "é")),
    *(("007", 7.0), (".5", 0.5), ("5.", 5.0), ("+3", 3.0), ("1e3", 1000.0), ("3,1", 3.1)),
]


@pytest.fixture
def folder(tmp_path):
    inside = tmp_path / "plates"
    inside.mkdir()
    (inside / "panel.toml").write_text(EXAMPLE.replace('"example"', '"panel"'), "utf-8")
    (tmp_path / "secret.toml").write_text("name = 'secret-outside'\n", "utf-8")
    for link in ("link.toml", "link.csv"):
        (inside / link).symlink_to(tmp_path / "secret.toml")
    return inside


@pytest.fixture
def client(folder):
    with TestClient(application(desk_of(folder), TOKEN, PORT), base_url=HERE) as made:
        assert made.get(f"/?token={TOKEN}").status_code == 200
        yield made


def dropped(name: Any, content: bytes, headers: dict[str, str] = POSTED) -> dict[str, Any]:
    kind = {"Content-Type": "application/octet-stream"}
    return {"params": {"name": str(name)[:200]}, "content": content, "headers": headers | kind}


def opened(client: TestClient, **asked: Any) -> str:
    return client.post("/open", json=asked, headers=POSTED).json()["go"]


def act(client: TestClient, visit: str, **asked: Any) -> Any:
    return client.post(f"{visit}/act", json=asked, headers=POSTED)


def edit(client: TestClient, visit: str, **change: Any) -> dict[str, Any]:
    answer = client.post(f"{visit}/edit", json={"structure": -1, **change}, headers=POSTED)
    assert answer.status_code == 200, answer.text
    return answer.json()


def text_of(client: TestClient, visit: str) -> str:
    return client.get(f"{visit}/plate.toml").text


def measured(client: TestClient, visit: str) -> dict[str, Any]:
    return tomllib.loads(text_of(client, visit))["measurement"]


def news(client: TestClient, visit: str, holds: str) -> dict[str, Any]:
    """The first news with this content in an element; the server reports every change."""
    seen = -1
    for _ in range(20):
        said = client.get(f"{visit}/news?seen={seen}&structure=-1").json()
        if any(holds in part for part in said["parts"].values()):
            return said
        seen = said["version"]
    raise AssertionError(f"no news of {holds}")


def test_errors_stand_at_their_fields_and_what_is_saved_is_what_the_command_reads(client, folder):
    visit, path = opened(client, example=True), folder / "example.toml"
    said = edit(client, visit, do="set", key="plate.length_mm", value="31o")["parts"]["error:plate.length_mm"]
    assert "31o" in said
    assert "accepted" in said
    parts = edit(client, visit, do="set", key="plate.length_mm", value="310")["parts"]
    assert "error:plate.length_mm" not in parts
    edit(client, visit, do="set", key="plate.mass_g", value="341.5")
    said = act(client, visit, do="save").json()
    assert said["said"] == "saved as example.toml"
    assert "cpam-bayes identify example.toml" in said["parts"]["tools"]
    assert tomllib.loads(path.read_text("utf-8"))["plate"]["mass_g"] == 341.5
    path.write_text("name = 'by hand'\n", "utf-8")
    answer = act(client, visit, do="save")  # another program's changes are not overwritten
    assert "changed by another program" in answer.json()["error"]
    assert (answer.status_code, path.read_text("utf-8")) == (400, "name = 'by hand'\n")


def test_a_table_that_is_dropped_is_the_list_and_its_rows_can_be_left_out(client, folder):
    visit = opened(client, file="panel.toml")
    table = b"mode,hz,sd\n1,80.2,0.1\n2,146.3,0.2\n3,218.6,0.2\n"
    said = client.post(f"{visit}/file", **dropped("modes.csv", table)).json()
    assert 'value="218.6"' in said["parts"]["form"]
    edit(client, visit, do="leave", index=2, value=True)
    measurement = map(measured(client, visit).get, ("table", "left_out", "frequencies_hz"))
    assert list(measurement) == ["modes.csv", [3], None]
    assert (folder / "modes.csv").read_bytes().startswith(b"mode,hz")
    wrong = client.post(f"{visit}/file", **dropped("other.csv", b"mode,hz\n1,abc\n"))
    assert "accepted: a frequency above 0" in wrong.json()["error"]
    assert (wrong.status_code, (folder / "other.csv").exists()) == (400, False)


def test_picks_of_a_recording_are_left_out_added_and_logged(client):
    visit = opened(client, file="panel.toml")
    assert client.post(f"{visit}/file", **dropped("tap.wav", b"RIFF")).status_code == 200
    assert 'data-low="50"' in news(client, visit, 'class="spectrum"')["parts"]["spectrum"]
    edit(client, visit, do="peak", value=144.5)  # at a pick: left out
    edit(client, visit, do="peak", value=349.0)  # between picks: the highest nearby line is added
    edit(client, visit, do="row", index=0, value="")  # a deleted pick is left out
    measurement = map(measured(client, visit).get, ("picked_from", "frequencies_hz", "left_out", "by_hand"))
    assert list(measurement) == ["tap.wav", [76.4, 144.4, 212.6, 350], [1, 2], [4]]
    edit(client, visit, do="peak", value=350.0)  # one added by hand is removed again
    edit(client, visit, do="leave", index=0, value=False)
    assert (measured(client, visit)["left_out"], measured(client, visit).get("by_hand")) == ([2], None)


def test_where_to_hold_and_hit_stands_on_the_page_before_there_are_frequencies(client):
    visit = opened(client, file="panel.toml")
    edit(client, visit, do="set", key="measurement.frequencies_hz", value="")
    drawing = news(client, visit, "Hold it on four soft pads.")["parts"]["drawing"]
    assert drawing.count('class="pad"') == 1
    assert 'class="hit"' in drawing


def test_the_plates_of_the_folder_are_listed_with_the_table_of_batch(client):
    assert act(client, "/folder", do="batch").status_code == 200
    assert 'data-open="panel.toml"' in news(client, "/folder", 'class="n">136.6')["parts"]["plates"]


def test_a_report_is_taken_away_as_page_workbook_and_json(client):
    visit = opened(client, example=True)
    assert client.get(f"{visit}/results.xlsx").status_code == 404
    act(client, visit, do="report")
    news(client, visit, f"{visit}/report")
    assert client.get(f"{visit}/results.xlsx").content.startswith(b"PK")
    assert client.get(f"{visit}/results.json").json() == {}


@pytest.mark.parametrize("patience", [0.0, 60.0])
def test_an_edit_is_never_answered_with_what_a_former_one_asked(patience):
    async def asked() -> list[tuple[Any, int]]:
        worker = Worker(patience)
        answers = [await worker.run(echo, "first")]
        for value in range(3):
            former = asyncio.ensure_future(worker.run(echo, "former"))
            for _ in range(value + 1):  # cancelled before, while and after it is sent
                await asyncio.sleep(0)
            former.cancel()
            answers.append(await worker.run(echo, value))
        worker.stop()
        return answers

    values, processes = zip(*asyncio.run(asked()), strict=True)
    assert values == ("first", 0, 1, 2)
    assert len(set(processes)) == 1 or not patience


def test_two_browsers_on_one_plate_do_not_mix_and_a_killed_server_loses_nothing(client, folder):
    visit, other = (opened(client, file="panel.toml") for _ in range(2))
    before = text_of(client, other)
    edit(client, visit, do="set", key="plate.width_mm", value="229.5")
    kept = text_of(client, visit)
    assert text_of(client, other) == before
    assert "229.5" in kept
    with TestClient(application(desk_of(folder), TOKEN, PORT), base_url=HERE) as again:
        again.get(f"/?token={TOKEN}")
        assert text_of(again, visit) == kept
        edit(again, visit, do="undo")
        assert text_of(again, visit) == before


def test_pages_explain_themselves_and_hold_nothing_but_style_script_and_plates_of_the_folder(client):
    page = client.get("/").text
    assert page.count("<li><b>") == 3
    said = [part in page for part in ('data-open="example"', 'data-open="panel.toml"', "link.toml")]
    assert said == [True, True, False]
    for path in ("/", opened(client), "/file/app.js"):
        policy = client.get(path).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert [word for word in ("http", "unsafe") if word in policy] == []
    for path in ("file/../server.py", "file/%2e%2e%2fserver.py", "file/app.py", "visit/../../etc/passwd"):
        assert client.get(f"/{path}").status_code == 404


def requests(n: int, visit: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Method, arguments of the client, and the reason for refusal."""
    dice = random.Random(38)
    for k in range(n):
        value = dice.choice(HOSTILE)
        path = dice.choice(("/", visit, f"{visit}/plate.toml", "/file/app.js", f"{visit}/news"))
        posted_to = dice.choice(("/open", f"{visit}/edit", f"{visit}/act"))
        name = "../x.toml" if value is None else value
        change: dict[str, Any] = dice.choice((
            {"do": value}, {"do": "set", "key": f"measurement.{value}", "value": "x"},
            {"do": "set", "key": "measurement.table", "value": "../secret.toml"},
            {"do": "row", "index": value, "value": []}, {"do": "sensor", "index": 0, "value": {"x": value}},
            {"do": "edge", "index": 9, "value": "C"}, {"do": "material", "value": value},
            {"do": "set", "key": "name", "value": "a\0b"},
        ))  # fmt: skip
        asked: tuple[tuple[str, str, dict[str, Any]], ...] = (
            ("token", path, {"headers": {"Cookie": f"cpam_bayes_{PORT}={value!r:.50}"}}),
            ("host", path, {"headers": {"Host": dice.choice(HOSTS)}}),
            ("origin", "/open", {"json": {}, "headers": {"Origin": dice.choice(ORIGINS)}}),
            ("no origin", posted_to, {"json": {}}),
            ("body", f"{visit}/edit", {"content": dice.choice(BODIES), "headers": POSTED | JSON}),
            ("file", "/open", {"json": {"file": name}, "headers": POSTED}),
            ("save", f"{visit}/act", {"json": {"do": "save", "name": name}, "headers": POSTED}),
            ("edit", f"{visit}/edit", {"json": change, "headers": POSTED}),
            ("upload name", f"{visit}/file", dropped(f"../{name}.wav" if k % 3 else f"{name}.toml", b"x")),
            ("upload of another", f"{visit}/file", dropped("panel.csv.exe", b"x")),
            ("upload that is no table", f"{visit}/file", dropped("t.csv", dice.randbytes(40))),
            ("upload over a link", f"{visit}/file", dropped("link.csv", b"hz\n1\n")),
            ("upload, no origin", f"{visit}/file", dropped("t.csv", b"hz\n80\n", {})),
            ("folder", "/folder/act", {"json": {"do": value}, "headers": POSTED}),
            ("results", f"{visit}/results.{dice.choice(('toml', 'json', 'xlsx', '../x'))}", {}),
        )
        why, url, options = asked[k % len(asked)]
        yield "GET" if why in ("token", "host", "results") else "POST", {"url": url, **options}, why


def listing(folder: Path) -> dict[str, bytes]:
    found = (p for p in folder.rglob("*") if p.is_file() and DRAFTS not in p.parts)
    return {str(p.relative_to(folder)): p.read_bytes() for p in found}


def test_hostile_requests_are_answered_with_an_error_and_touch_no_file(client, folder):
    visit = opened(client, example=True)
    before, text = listing(folder.parent), text_of(client, visit)
    for method, asked, why in requests(int(os.environ.get("CPAM_BAYES_HOSTILE", "240")), visit):
        answer = client.request(method, follow_redirects=False, **asked)
        assert 400 <= answer.status_code < 500, (why, asked, answer.status_code)
        assert [word for word in ("secret-outside", TOKEN) if word in answer.text] == []
    assert (listing(folder.parent), text_of(client, visit)) == (before, text)


def test_a_plate_file_that_names_a_file_outside_the_folder_is_not_followed(client, folder):
    table = EXAMPLE.partition("[measurement]")[0] + '[measurement]\ntable = "../secret.toml"\n'
    (folder / "outside.toml").write_text(table, "utf-8")
    visit = opened(client, file="outside.toml")
    said = json.dumps(client.get(f"{visit}/news?seen=-1&structure=-1").json())
    assert "leaves the folder" in said
    assert "secret-outside" not in said


def test_what_takes_long_says_how_long_the_rest_of_its_stage_takes(folder, monkeypatch):
    now, said = 100.0, list[tuple[float, str]]()
    monkeypatch.setattr("cpam_bayes.render.terminal.time.monotonic", lambda: now)
    with Shown(lambda done, text: said.append((done, text))).stage("weighing", 80) as shown:
        now = 130.0
        shown.tick(20, 0.0)
    assert said == [(0.0, "weighing"), (0.25, "weighing, about 2 min left")]  # 60 of 80 at 1.5 s each
    work = Work(desk=desk_of(folder), file="batch", doing=("diagnose", *said[1]))
    assert "about 2 min left" in folder_news([], work)["parts"]["doing"]


# A plate file as text: the value changes, everything else stays


def without(data: dict, key: str) -> dict:
    table, _, name = key.rpartition(".")
    inner = {k: v for k, v in (data[table] if table else data).items() if k != name}
    return {**data, table: inner} if table else inner


@pytest.mark.parametrize("key", [key for key in FIELDS if not key.startswith("environment")])
def test_a_field_changes_its_own_value_and_no_other(key):
    before, after = tomllib.loads(PANEL), tomllib.loads(with_value(PANEL, key, "17"))
    assert without(after, key) == without(before, key)
    table, _, name = key.rpartition(".")
    assert (after[table] if table else after)[name] in (17, [17], "17")


def test_a_table_is_made_an_empty_field_takes_its_key_away_and_a_list_over_lines_is_replaced_whole():
    with_air = tomllib.loads(with_value(PANEL, "environment.air_density_kg_m3", "1.19"))
    assert with_air["environment"] == {"air_density_kg_m3": 1.19}
    emptied = tomllib.loads(with_value(PANEL, "measurement.relative_std", ""))
    assert "relative_std" not in emptied["measurement"]
    text = "[measurement]\nfrequencies_hz = [\n  80.2, # first\n  146.3,\n]\nrelative_std = 0.01\n"
    after = tomllib.loads(with_value(text, "measurement.frequencies_hz", "90 91"))
    assert after == {"measurement": {"frequencies_hz": [90, 91], "relative_std": 0.01}}


def test_pasted_lists_are_read_however_they_are_parted():
    lists = {"102, 311; 342": ["102", "311", "342"], "102\n311\r\n342\n": ["102", "311", "342"]}
    lists |= {"102,5 311,2": ["102,5", "311,2"], "1\t102.5\n": ["1", "102.5"]}
    lists |= {"102.5,311.2,342.1": ["102.5", "311.2", "342.1"]}
    assert {typed: plate_text.numbers_in(typed) for typed in lists} == lists


@pytest.mark.parametrize(("typed", "read"), NUMBERS)
def test_a_number_as_people_type_it_is_that_number_and_else_kept_as_words(typed, read):
    text = with_value(PANEL, "plate.length_mm", typed)
    assert tomllib.loads(text)["plate"]["length_mm"] == read
    pairs = zip(PANEL.split("\n"), text.split("\n"), strict=True)
    # comments and order are kept
    assert [old.split("#")[1:] == new.split("#")[1:] for old, new in pairs if old != new] == [True]


def test_masses_and_the_material_are_replaced_as_a_whole():
    one = with_sensors(PANEL, [{"mass_g": "1.2", "x_mm": "3", "y_mm": "4"}])
    assert tomllib.loads(one)["sensor"] == [{"mass_g": 1.2, "x_mm": 3, "y_mm": 4}]
    assert tomllib.loads(with_sensors(one, [])) == tomllib.loads(PANEL)
    other = tomllib.loads(plate_text.with_block(PANEL, "material", ["E1_GPa = 70.0"]))
    assert other["material"].pop("E1_GPa") == 70.0
    assert without(other, "material") == without(tomllib.loads(PANEL), "material")


@pytest.mark.parametrize("source", ['recordings = ["hits"]\nrange_hz = [20.0, 900.0]', 'peaks = "peaks.csv"'])
def test_a_file_that_is_dropped_takes_the_place_of_whatever_the_list_was(source):
    text = f"[measurement]\n{source}\nleft_out = [2]\nrelative_std = 0.002\n"
    measured = tomllib.loads(with_file(text, "table", "modes.csv"))["measurement"]
    assert measured == {"table": "modes.csv", "relative_std": 0.002}
