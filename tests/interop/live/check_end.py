"""Watches a throw with `--web` on the default bus to its end, and after it, in a real browser.

    check_end.py CUBECTL OUT      pictures and the throw go into the folder OUT

The throw runs in real time. After it the page stays as long as the terminal does: it keeps its last picture, says "ended" and how, shows
nothing as good that may have changed since, and links the report.
"""

import os
import pathlib
import pty
import re
import signal
import subprocess
import sys
import time

from browser import PATIENCE_S, Page, wait_for

LINK = "document.getElementById('link')?.textContent"
GREEN = "[...document.querySelectorAll('.good')].filter(one => one.offsetParent).map(one => one.textContent)"


def main(cubectl, out):
    folder = pathlib.Path(out)
    terminal, other = pty.openpty()
    words = ["throw", "--target", "1,1,-1", "--web", "0", "--out", str(folder / "throw")]
    throw = subprocess.Popen([cubectl, *words], stdin=other, stdout=other, stderr=other)
    os.close(other)
    os.set_blocking(terminal, False)
    said = ""

    def heard():
        nonlocal said
        try:
            said += os.read(terminal, 1 << 16).decode(errors="replace")
        except BlockingIOError:
            pass
        return said

    def shows(link):
        heard()
        return page.value(LINK) == link

    page = Page(folder)
    try:
        url = wait_for("the live view", lambda: re.search(r"live view at (http://\S+/)", heard()))[1]
        page.order("Page.enable")
        page.order("Runtime.enable")
        page.show(1280, 800, dark=False)
        page.order("Page.navigate", url=url)
        wait_for("the page", lambda: shows("live"))
        begun = time.monotonic()
        wait_for("the end", lambda: shows("ended"))
        assert time.monotonic() - begun > 5, "homing alone takes longer in real time"
        rows = page.value("document.getElementById('joints').innerText")
        for name, width, height, dark in [("ended", 1280, 800, False), ("ended_phone", 390, 844, False), ("ended_dark", 1280, 800, True)]:
            page.show(width, height, dark)
            page.picture(folder / f"{name}.png", whole=False)
        page.show(1280, 800, dark=False)
        assert page.value("document.getElementById('joints').innerText") == rows and "homed" in rows, rows
        assert page.value("document.getElementById('ended').textContent").startswith("ended: landed")
        assert page.value(GREEN) == [], page.value(GREEN)
        assert "shows the end and the report until Ctrl-C" in heard()
        page.order("Page.navigate", url=page.value("document.querySelector('#ended a').href"))
        wait_for("the report", lambda: "landed" in (page.value("document.querySelector('.answer')?.textContent") or ""))
        page.picture(folder / "report.png", whole=False)
        throw.send_signal(signal.SIGINT)
        assert throw.wait(PATIENCE_S) == 0, heard()
    finally:
        page.browser.kill()
        throw.kill()
    print("the page of a throw that ended keeps its picture and links its report")


main(*sys.argv[1:])
