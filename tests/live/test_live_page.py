"""Live view in a browser: a simulated camera is aligned, detected, saved and inverted."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest

import correlograph as cg
from scenes import scene_path

pytest.importorskip("mitsuba")
pytest.importorskip("panel")
webdriver = pytest.importorskip("selenium.webdriver")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="chromium and chromedriver are not installed"),
]
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")


@pytest.fixture
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for option in (*OPTIONS, "--disable-component-update", "--disable-sync", "--window-size=1200,1300"):
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture
def live(tmp_path):
    """live(*arguments) -> (process, address of the page), for a small copy of the reference scene."""
    text = scene_path("corner_letter").read_text().replace('value="2464"', 'value="616"').replace('value="2056"', 'value="514"')
    (tmp_path / "scene.xml").write_text(text)
    shutil.copy(scene_path("corner_letter").with_name("F.png"), tmp_path)
    started = []

    def start(*arguments: str):
        command = [sys.executable, "-m", "correlograph", "live", "--simulate", "scene.xml", "-o", "saved", *arguments]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process, re.search(r"http://\S+", process.stdout.readline())[0]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def page_text(browser) -> str:
    """Text of the page, which Panel keeps in nested shadow roots."""
    script = """
    const texts = [];
    const visit = node => {
      if (node.nodeType === Node.TEXT_NODE) texts.push(node.textContent);
      if (node.tagName === 'STYLE') return;
      if (node.shadowRoot) visit(node.shadowRoot);
      node.childNodes.forEach(visit);
    };
    visit(document.body);
    return texts.join(' ');
    """
    return " ".join(browser.execute_script(script).split())


def press(browser, label: str) -> None:
    script = """
    const find = node => {
      if (node.tagName === 'BUTTON' && node.textContent.trim() === arguments[0]) return node;
      for (const child of [...(node.shadowRoot ? node.shadowRoot.childNodes : []), ...node.childNodes]) {
        const found = find(child);
        if (found) return found;
      }
      return null;
    };
    find(document.body).click();
    """
    browser.execute_script(script, label)


def wait_for(browser, pattern: str, seconds: float = 90.0) -> re.Match[str]:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if found := re.search(pattern, page_text(browser)):
            return found
        time.sleep(0.3)
    raise AssertionError(f"{pattern!r} is not in {page_text(browser)!r}")


def test_a_simulated_capture_is_detected_saved_and_inverted(browser, live, tmp_path):
    process, address = live("-D", "exposure=0.02", "--frames-per-s", "3")
    browser.get(address)
    wait_for(browser, r"object found, confidence 0\.[5-9]")
    for name in (
        "photoelectrons",
        "speckle contrast",
        "speckle grain",
        "degrees of freedom K",
        "third moment",
        "floor over peak",
    ):
        assert name in page_text(browser)
    press(browser, "Restart the estimate")
    begin = int(wait_for(browser, r"starts again after frame (\d+)")[1])
    received, used, deadline = 0, 0, time.monotonic() + 90.0
    while received <= begin:  # until the table is that of after the restart
        assert time.monotonic() < deadline
        shown = wait_for(browser, r"frames received (\d+).* frames in the estimate (\d+) ")
        received, used = int(shown[1]), int(shown[2])
    assert used <= received - begin
    press(browser, "Reconstruct with quality balanced")
    wait_for(browser, r"confidence [\d.]+ \(balanced\)", 300.0)
    press(browser, "Save the frames")
    folder = tmp_path / wait_for(browser, r"saved: (\S+)")[1]
    browser.get("about:blank")  # closing the page loses no frame that is saved
    frames = sorted(folder.glob("frame_*.exr"))
    assert len(frames) > 1
    result = cg.reconstruct(folder, quality="fast")
    assert result.object_found
    assert result.estimate.pitches_m is not None
    process.terminate()
    assert "Traceback" not in process.communicate(timeout=30)[1]


def test_only_this_machine_with_the_token_sees_the_page(live):
    _, address = live()
    root, token = address.rsplit("/", 1)
    with urllib.request.urlopen(address) as page:
        assert page.status == 200
    for path in ("", "x", token[:-1], f"{token}x", "ws", "autoload.js", "liveness", "admin"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(f"{root}/{path}")
        assert refused.value.code in (403, 404)
        refused.value.close()
    port = int(root.rsplit(":", 1)[1])
    for family, _, _, _, place in socket.getaddrinfo(socket.gethostname(), port, type=socket.SOCK_STREAM):
        if not place[0].startswith("127.") and place[0] != "::1":
            with socket.socket(family, socket.SOCK_STREAM) as other:
                other.settimeout(2.0)
                assert other.connect_ex(place) != 0
