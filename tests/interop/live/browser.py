"""A page in Debian's Chromium, spoken to over its debugging port."""

import base64
import json
import subprocess
import time
import urllib.request

import websocket

CHROMIUM = [
    "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
    "--remote-debugging-port=0", "--remote-allow-origins=*",
]
# Only a hang lasts as long, on a busy machine too.
PATIENCE_S = 120


def wait_for(what, look):
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        found = look()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"{what}: not within {PATIENCE_S} s")


class Page:
    """A page of the browser, spoken to over its debugging port."""

    def __init__(self, folder):
        self.browser = subprocess.Popen(
            [*CHROMIUM, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        reported = folder / "profile" / "DevToolsActivePort"
        port = wait_for("the browser", lambda: reported.exists() and reported.read_text().split("\n")[0])
        targets = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        page = next(target for target in targets if target["type"] == "page")
        self.wire = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=PATIENCE_S)
        self.number = 0

    def order(self, method, **parameters):
        self.number += 1
        self.wire.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.wire.recv())
            if answer.get("method") == "Runtime.exceptionThrown":
                raise AssertionError(f"the page's script fails: {answer['params']}")
            if answer.get("id") == self.number:
                assert "error" not in answer, answer
                return answer["result"]

    def value(self, expression):
        result = self.order("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def show(self, width, height, dark):
        self.order(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        scheme = "dark" if dark else "light"
        self.order("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def picture(self, path, whole=True):
        """Of the whole page, or of what the window shows."""
        self.value("new Promise(done => setTimeout(done, 400))")
        data = self.order("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def point_at(self, x, y):
        """Moves the mouse there, in pixels of the window."""
        self.order("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
