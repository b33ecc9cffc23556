"""Looks at the live view in a real browser while a controller homes the simulated cell, and holds it against the recording.

    check_page.py CUBECTL OUT      pictures and recordings go into the folder OUT

The page must show, for every joint, the angle that its drive reported last before the time the page names; its stop button must
halt the drives; a page of another origin must get nothing.
"""

import pathlib
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

from browser import PATIENCE_S, Page, wait_for
from readings import positions


ROWS = """[...document.querySelectorAll('#joints tr')].slice(1).map(row => ({t_s: +row.dataset.tS,
  q: row.cells[1].textContent.replace('−', '-')}))"""


# The chart of the angles in the window, and what it shows under the pointer.
ANGLES = """(() => { const svg = document.querySelector('#angles svg'); svg.scrollIntoView({block: 'center'});
  const box = svg.getBoundingClientRect(); return [box.left + 0.97 * box.width, box.top + 0.5 * box.height]; })()"""
TOLD = "[...document.querySelectorAll('#angles .tip tspan')].map(line => line.textContent).join(', ').replace('s:, ', 's: ')"


DRAWN = """(() => { const c = document.getElementById('scene');
  const all = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 3; i < all.length; i += 4) if (all[i] > 0) n++; return n; })()"""


# The same with a ball nobody knows the place of.
DRAWN_WITHOUT_BALL = f"""(() => {{ const step = {{...scene.steps[0], ball: null}};
  dispatchEvent(new CustomEvent('live-step', {{detail: step}})); return {DRAWN}; }})()"""


STOP_IS_IN_SIGHT = """(() => { const stop = document.getElementById('stop'), box = stop.getBoundingClientRect();
  return document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2) === stop; })()"""
# What is shown as good.
GREEN = "[...document.querySelectorAll('.good')].filter(one => one.offsetParent).map(one => one.textContent)"


def refused(url, **headers):
    try:
        urllib.request.urlopen(urllib.request.Request(url, headers=headers))
    except urllib.error.HTTPError as error:
        return error.code
    return None


def main(cubectl, out):
    folder = pathlib.Path(out)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        bus = f"socketcand://127.0.0.1:{probe.getsockname()[1]}/can0"
    processes = []

    def start(name, *words):
        log = open(folder / f"{name}.log", "w")
        process = subprocess.Popen([cubectl, *words], stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        processes.append(process)
        return process, lambda: (folder / f"{name}.log").read_text()

    try:
        start("sim", "sim", "--bus", bus)
        answers = lambda verb: subprocess.run([cubectl, verb, "--bus", bus], capture_output=True).returncode == 0
        wait_for("the drives", lambda: answers("status"))
        controller, _ = start("controller", "controller", "run", "--bus", bus)
        wait_for("the cell", lambda: answers("status"))
        words = ["arm", "monitor", "--bus", bus, "--web", "0", "--record", str(folder / "seen")]
        monitor, said = start("monitor", *words)
        url = wait_for("the live view", lambda: re.search(r"live view at (http://\S+/)", said()))[1]
        assert refused(url, Origin="http://evil.example") == 403
        assert refused(url, Host="evil.example") == 403

        page = Page(folder)
        processes.append(page.browser)
        page.order("Page.enable")
        page.order("Runtime.enable")
        page.show(1280, 1500, dark=False)
        page.order("Page.navigate", url=url)
        wait_for("the page", lambda: page.value("document.getElementById('link')?.textContent") == "live")
        home, home_said = start("home", "home", "--bus", bus)
        shown, pointed = [], []
        page.point_at(*page.value(ANGLES))
        while home.poll() is None:
            rows, tip = page.value(f"[{ROWS}, {TOLD}]")
            shown.append(rows)
            pointed.append(tip)
            time.sleep(0.05)
            if len(shown) == 20:
                page.picture(folder / "desktop.png", whole=False)
        assert home.returncode == 0, home_said()
        for name, width, height, dark in [("dark", 1280, 1500, True), ("phone", 390, 844, False)]:
            page.show(width, height, dark)
            page.order("Page.reload")
            wait_for("the page", lambda: page.value("document.getElementById('link')?.textContent") == "live")
            page.value("new Promise(done => setTimeout(done, 1500))")
            page.value("scrollTo(0, 0)")
            page.picture(folder / f"{name}.png")
        high = page.value("document.documentElement.scrollHeight")
        assert high <= 2 * 844, f"two screens of a phone, not {high} px"
        page.value("scrollTo(0, document.documentElement.scrollHeight)")
        assert page.value(STOP_IS_IN_SIGHT), "the stop button stays in sight"
        state = page.value("document.getElementById('state').textContent")
        assert state == "ready", state
        events = page.value("document.getElementById('events').textContent")
        assert "6 joints homed" in events, events
        assert page.value("scene.hand.length") > 10, "the hand's path grows"
        drawn = page.value(DRAWN)
        assert drawn > 5000, f"the arm is drawn: {drawn} points of the picture have a colour"
        assert "bound ±50 mrad" in page.value("document.getElementById('errors').textContent")
        without = page.value(DRAWN_WITHOUT_BALL)
        assert 5000 < without < drawn, f"an open gripper has no ball: {without} points of {drawn}"

        page.value("document.getElementById('stop').click()")
        wait_for("the stop", lambda: "stopped from the page" in said())
        banner = "document.getElementById('stopped').textContent"
        wait_for("its answer", lambda: "stopped by this program: joints 1, 2, 3, 4, 5, 6 stand after" in page.value(banner))
        wait_for("who obeyed", lambda: "stand after" in said())
        # The controller says that it was stopped, the page that drives are halted.
        halted = "document.getElementById('joints').textContent + document.getElementById('state').textContent"
        wait_for("the halt", lambda: re.search("halted|not ready|stopped|fault", page.value(halted)))
        page.picture(folder / "stopped.png", whole=False)
        controller.kill()
        state = "document.getElementById('state').textContent"
        wait_for("the silence of the controller", lambda: page.value(state).startswith("not heard for"))
        page.picture(folder / "killed.png", whole=False)
        assert page.value(GREEN) == [], page.value(GREEN)
        monitor.send_signal(signal.SIGINT)
        assert monitor.wait(PATIENCE_S) in (0, 6), said()
        wait_for("the page to notice", lambda: "not connected" in page.value("document.getElementById('link').textContent"))
        # Nothing stays green after what it was heard from is gone.
        shown_state = "(b => [b.textContent, b.className, document.getElementById('link').className])(document.getElementById('state'))"
        text, tone, link = wait_for("the old state", lambda: (v := page.value(shown_state))[0].startswith("not heard for") and v)
        assert "bad" in tone and "warn" in link, (text, tone, link)
    finally:
        for process in reversed(processes):
            process.kill()

    reported = positions(folder / "seen.mcap")
    compared, moved = 0, set()
    for rows in shown:
        for module, row in enumerate(rows, start=1):
            if row["q"] == "–":
                continue
            # A reading of the very microsecond may have come after the look.
            shown_us = row["t_s"] * 1e6
            before = [q for at_us, q in reported[module] if at_us < shown_us - 0.5]
            reported_then = before[-1:] + [q for at_us, q in reported[module] if abs(at_us - shown_us) <= 0.5]
            assert reported_then, f"module {module} had reported nothing at {row['t_s']} s"
            assert any(abs(q - float(row["q"])) <= 0.51e-4 for q in reported_then), (module, row, reported_then)
            compared += 1
            moved.add((module, row["q"]))
    under = 0
    for text in filter(None, pointed):
        time_s, values = text.split(" s: ")
        for module, value in enumerate(values.split(", "), start=1):
            name, q = value.rsplit(" ", 1)
            assert name == f"joint{module}", text
            # The page's snapshots are 20 ms apart, and show what was reported last before.
            near = [reported_q for at_us, reported_q in reported[module] if -0.15 <= at_us * 1e-6 - float(time_s) <= 0.002]
            assert any(abs(reported_q - float(q.replace("−", "-"))) <= 0.6e-3 for reported_q in near), (module, text, near)
            under += 1
    assert under > 60, f"only {under} angles under the pointer"
    assert compared > 100, f"only {compared} angles were compared"
    assert len(moved) > 20, "the arm moved"
    print(f"{len(shown)} looks at the page, {compared} angles as in the recording, {len(moved)} different ones; {under} under the pointer")


main(*sys.argv[1:])
