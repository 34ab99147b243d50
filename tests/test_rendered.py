"""The exploring notebook in a browser: Voila serves it, headless Chromium shows it and moves a slider."""

import asyncio
import base64
import importlib.util
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

NOTEBOOK = Path(__file__).parents[1] / "notebooks" / "exploring.ipynb"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE = 240
pytestmark = [
    pytest.mark.study,
    pytest.mark.skipif(CHROMIUM is None or importlib.util.find_spec("voila") is None, reason="no Chromium or no Voila"),
]


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


async def reached(address):
    for _ in range(PATIENCE):
        try:
            return urllib.request.urlopen(address, timeout=PATIENCE).read()
        except urllib.error.HTTPError:  # a server that answers
            return b""
        except OSError:
            await asyncio.sleep(0.5)
    raise TimeoutError(address)


class Page:
    """A page of a browser, asked in the words of its debugger."""

    def __init__(self, socket):
        self.socket, self.count = socket, 0

    async def ask(self, method, **parameters):
        self.count += 1
        await self.socket.write_message(json.dumps({"id": self.count, "method": method, "params": parameters}))
        while (answer := json.loads(await self.socket.read_message())).get("id") != self.count:
            pass
        return answer.get("result", {})

    async def value(self, script):
        found = await self.ask("Runtime.evaluate", expression=script, returnByValue=True)
        return found["result"].get("value")

    async def until(self, script, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not (found := await self.value(script)):
            assert time.monotonic() < end, script
            await asyncio.sleep(0.1)
        return found

    async def press(self, key, code):
        for kind in ("keyDown", "keyUp"):
            await self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    async def picture(self):
        shown = await self.ask("Page.captureScreenshot", format="png")
        return Image.open(io.BytesIO(base64.b64decode(shown["data"]))).convert("RGB")


async def looked_at(port, debugger, folder):
    """Two screenshots, before and after the first slider has moved."""
    from tornado.websocket import websocket_connect

    pages = json.loads(await reached(f"http://127.0.0.1:{debugger}/json"))
    await reached(f"http://127.0.0.1:{port}/voila/static/")
    address = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
    page = Page(await websocket_connect(address, max_message_size=2**28))
    await page.ask("Page.navigate", url=f"http://127.0.0.1:{port}/")
    await page.until("document.querySelectorAll('img.widget-image').length >= 2")
    assert not await page.value("document.body.innerText.includes('Loading widget')")
    first = await page.picture()
    source = "document.querySelector('img.widget-image').src"
    before = await page.value(source)
    await page.value("document.querySelector('.noUi-handle').focus()")
    for _ in range(20):
        await page.press("ArrowLeft", 37)
    await page.until(f"{source} != {json.dumps(before)}", 10)
    await asyncio.sleep(1.0)
    second = await page.picture()
    first.save(folder / "first.png")
    second.save(folder / "second.png")
    return first, second


def test_a_slider_moves_the_map_in_a_browser(tmp_path):
    port, debugger = free_port(), free_port()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    commands = [
        [sys.executable, "-m", "voila", str(NOTEBOOK), "--no-browser", f"--port={port}", "--Voila.ip=127.0.0.1"],
        [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1100,1600",
         f"--remote-debugging-port={debugger}", f"--user-data-dir={tmp_path / 'profile'}", "about:blank"],
    ]
    started = [subprocess.Popen(command, **quiet) for command in commands]
    try:
        pictures = asyncio.run(asyncio.wait_for(looked_at(port, debugger, tmp_path), PATIENCE))
    finally:
        for one in started:
            os.killpg(one.pid, signal.SIGTERM)
            one.wait()
    first, second = (np.asarray(picture, float) for picture in pictures)
    # both are pictures in colour, and they differ by more than a slider's handle
    assert np.ptp(first, axis=2).max() > 100
    assert (np.abs(first - second).max(axis=2) > 30).sum() > 2000
