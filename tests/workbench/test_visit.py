"""A visit in a browser: a plate typed, its list pasted; a claim seen, applied, saved and reported."""

import json
import re
import signal
import subprocess
import sys
import threading
import tomllib
from typing import Any

import pytest
import uvicorn

import cpam_bayes as cb
from cpam_bayes.workbench.server import application, free_port
from tests.browser import Browser, disturbing, open_browser
from tests.quick_page import desk_of

pytestmark = pytest.mark.needs_browser

SIZES = {"length_mm": "300", "width_mm": "210", "thickness_mm": "3", "mass_g": "510.3"}
TYPED = {f"plate.{key}": text for key, text in SIZES.items()}


@pytest.fixture
def address(tmp_path):
    command = [sys.executable, "-m", "cpam_bayes", "app", str(tmp_path), "--port", "0", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    yield process.stdout.readline().strip()
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "nothing is lost" in said


def frequencies() -> list[float]:
    sizes = {key: float(text) for key, text in SIZES.items()}
    plate = {
        "name": "tapped", "plate": {**sizes, "edges": "FFFF"},
        "material": {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.335},
        "sensor": [{"mass_g": 12.0, "x_mm": 250.0, "y_mm": 160.0}], "environment": {"air_density_kg_m3": 1.2},
    }  # fmt: skip
    return [round(mode["frequency_hz"], 1) for mode in cb.forward(plate, 10).to_dict()["modes"]]


def given(browser: Browser, what: str, value: str, event: str) -> None:
    """Set a value in a single step like a key does: a form redrawn in between would lose it."""
    browser.value(
        f"""(() => {{ const at = document.querySelector({json.dumps(what)}); at.value = {json.dumps(value)};
        at.dispatchEvent(new Event("{event}", {{ bubbles: true }})); }})()"""
    )


def typed(browser: Browser, values: dict[str, str]) -> None:
    for key, value in values.items():
        given(browser, f"[data-key='{key}']", value, "input")


def click(browser: Browser, what: str) -> None:
    browser.value(f"document.querySelector({json.dumps(what)}).click()")


def text(browser: Browser, what: str) -> Any:
    return browser.value(f"document.querySelector({json.dumps(what)})?.innerText")


def there(browser: Browser, what: str) -> None:
    browser.until(f"!!document.querySelector({json.dumps(what)})")


def test_a_plate_is_typed_its_list_pasted_and_the_constants_are_those_of_the_command(address, tmp_path):
    with open_browser() as browser:
        browser.visit(address, 390)
        assert disturbing(browser, 390) == []
        click(browser, "[data-open=example]")
        there(browser, "#answer table")
        assert disturbing(browser, 390) == []
        browser.visit(address, 1280)
        assert disturbing(browser, 1280) == []
        click(browser, "[data-open=blank]")
        there(browser, "#form [data-paste]")
        given(browser, "[data-material]", "metal", "change")
        browser.until("""document.querySelectorAll("[data-key^='material.']").length === 2""")
        typed(browser, TYPED | {"plate.length_mm": "30o"})
        browser.until("document.getElementById('error:plate.length_mm').textContent.includes('accepted')")
        typed(browser, TYPED | {"measurement.relative_std": "0.001"})
        pasted = json.dumps(" ".join(map(str, frequencies())))
        browser.value(f"document.querySelector('[data-paste]').value = {pasted}")
        click(browser, "[data-take]")
        there(browser, "#answer .headline ~ * .constants")  # the advice before the list has a headline too
        assert browser.value("""document.querySelector("[data-key='plate.length_mm']").value""") == "300"
        click(browser, "[data-act=save]")
        browser.until("document.getElementById('said').textContent.startsWith('saved as')")
        at_rest = text(browser, "#answer .constants")  # at rest: the digits that the command prints
        assert disturbing(browser, 1280) == []
        printed = cb.identify(tmp_path / "plate.toml").summary()
        for constant in re.findall(r"^  (E1|nu12)\s+(\S+)", printed, re.MULTILINE):
            assert re.search(rf"{constant[0]}\s+{re.escape(constant[1])}", at_rest)
        assert browser.console == []
        here = address.partition("?")[0]
        assert [url for url in browser.requests if not url.startswith((here, "data:"))] == []


@pytest.fixture
def quick_address(tmp_path):
    port = free_port(0)
    page = application(desk_of(tmp_path), "token", port)
    server = uvicorn.Server(uvicorn.Config(page, port=port, log_level="error", ws="none"))
    thread = threading.Thread(target=server.run)
    thread.start()
    yield f"http://127.0.0.1:{port}/?token=token"
    server.should_exit = server.force_exit = True
    thread.join()


def test_a_claim_is_applied_saved_and_reported_and_picks_are_changed_by_clicks(quick_address, tmp_path):
    def saved() -> dict[str, Any]:
        click(browser, "[data-act=save]")
        browser.until("document.getElementById('said').textContent.startsWith('saved as')")
        return tomllib.loads((tmp_path / "example.toml").read_text("utf-8"))

    def clicked(hz: float) -> None:
        browser.value(
            f"""(() => {{ const at = document.querySelector(".spectrum"), box = at.getBoundingClientRect(),
            x = box.left + box.width * ({hz} - at.dataset.low) / (at.dataset.high - at.dataset.low);
            at.dispatchEvent(new MouseEvent("click", {{ clientX: x, clientY: box.top + 9, bubbles: true }}));
            }})()"""
        )

    with open_browser() as browser:
        browser.visit(quick_address, 390)
        click(browser, "[data-open=example]")
        there(browser, "#diagnosis .headline")
        assert text(browser, "#diagnosis .headline") == "A mass."
        there(browser, "#drawing .found")
        click(browser, "[data-edit=apply]")
        there(browser, "[data-sensor]")
        assert saved()["sensor"] == [{"mass_g": 5.10, "x_mm": 262, "y_mm": 171}]
        click(browser, "[data-edit=undo]")
        browser.until("!document.querySelector('[data-sensor]')")
        click(browser, "[data-act=report]")
        there(browser, "#tools a[href$=report]")
        browser.value("""drop(new File(["RIFF"], "tap.wav")) && 1""")
        there(browser, ".spectrum")
        clicked(144.4)
        there(browser, "tr.out [data-row='1']")
        clicked(349.0)
        there(browser, ".spectrum .hand")
        assert disturbing(browser, 390) == []
        measurement = saved()["measurement"]
        assert measurement["frequencies_hz"] == [76.4, 144.4, 212.6, 350]
        assert (measurement["left_out"], measurement["by_hand"]) == ([2], [4])
        assert browser.console == []
