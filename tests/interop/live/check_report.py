"""Points at charts of a report in a real browser, and holds what is told under the pointer against recording and plan.

    check_report.py CUBECTL OUT      pictures, throw and report go into the folder OUT

Of each joint the angle of the sample under the pointer must be one that its drive told at that time of the plan, the reference must
be that of the plan file, the error must be the difference of the two.
"""

import json
import pathlib
import re
import subprocess
import sys

from browser import Page
from readings import plan_begins, positions

#: Places in each chart at which the pointer is put, as shares of its frame.
PLACES = [0.03 + 0.94 * k / 20 for k in range(21)]
CHARTS = """[...document.querySelectorAll('svg[data-time]')].map(svg => svg.getAttribute('aria-label'))"""
# The frame of a chart in the window, after it was scrolled there.
FRAME = """(() => { const svg = document.querySelectorAll('svg[data-time]')[%d]; svg.scrollIntoView({block: 'center'});
  const box = svg.getBoundingClientRect(), scale = box.width / svg.viewBox.baseVal.width;
  const [x0, x1, left, width, top, height] = svg.dataset.time.split(' ').map(Number);
  return [box.left + scale * left, scale * width, box.top + scale * (top + height / 2), x0, x1]; })()"""
TIP = "[...document.querySelectorAll('svg[data-time]')[%d].querySelectorAll('.tip tspan')].map(line => line.textContent).join(', ').replace('s:, ', 's: ')"


def number(text):
    return float(text.replace("−", "-"))


def told(tip):
    """Time in s, and the value of each curve by its name; of a curve without a value `None`."""
    time, rest = re.fullmatch(r"(−?[0-9.]+) s: (.*)", tip).groups()
    values = {}
    for part in rest.split(", "):
        name, _, value = part.rpartition(" ")
        values[name] = None if value == "–" else number(value)
    return number(time), values


def reference(plan, joint, t_s):
    """Angle of a joint by the knots of the plan file."""
    knots = plan["motion"]["knots"]
    if t_s <= 0 or t_s >= knots[-1]["t_s"]:
        return knots[0 if t_s <= 0 else -1]["q_rad"][joint]
    a, b = next((a, b) for a, b in zip(knots, knots[1:]) if t_s <= b["t_s"])
    h = b["t_s"] - a["t_s"]
    s = (t_s - a["t_s"]) / h
    q0, q1, v0, v1 = a["q_rad"][joint], b["q_rad"][joint], a["qd_rad_s"][joint], b["qd_rad_s"][joint]
    return (1 + 2 * s) * (1 - s) ** 2 * q0 + s * (1 - s) ** 2 * h * v0 + s * s * (3 - 2 * s) * q1 - s * s * (1 - s) * h * v1


def same(shown, value):
    """Four digits are shown."""
    return abs(shown - value) <= 0.51e-3 * max(abs(value), 1e-9)


def main(cubectl, out):
    folder = pathlib.Path(out)
    throw = folder / "throw"
    command = [cubectl, "throw", "--target", "1.0,1.0,-1.0", "--seed", "6", "--out", str(throw)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    page = Page(folder)
    try:
        looks = look(page, throw / "report.html", folder)
    finally:
        page.browser.kill()
    plan = json.loads((throw / "plan.json").read_text())
    begin_s = plan_begins(throw / "bus.mcap")
    log = {module: [(at_us * 1e-6, q) for at_us, q in rows] for module, rows in positions(throw / "bus.mcap").items()}
    angles, errors, moved = 0, 0, set()
    for joint in range(6):
        name = f"joint{joint + 1}"
        for t_s, values in looks[f"{name}: position"]:
            if values["measured"] is None:
                continue
            # The session's time of the sample is known to the time that the controller's words take.
            near = [(at, q) for at, q in log[joint + 1] if abs(at - begin_s - t_s) < 0.015 and same(values["measured"], q)]
            assert near, (name, t_s, values)
            span = [reference(plan, joint, t_s + dt) for dt in (-0.0006, 0.0, 0.0006)]
            room = 0.51e-3 * abs(span[1]) + 1e-6
            assert min(span) - room <= values["reference"] <= max(span) + room, (name, t_s, values, span)
            angles += 1
            moved.add((joint, values["measured"]))
        by_time = dict(looks[f"{name}: position"])
        for t_s, values in looks[f"{name}: position error"]:
            of = by_time.get(t_s)
            if of is None or of["measured"] is None:
                continue
            error_mrad = 1e3 * (of["reference"] - of["measured"])
            # Both angles are shown with four digits.
            room = 0.51 * (abs(of["reference"]) + abs(of["measured"])) + 0.01
            assert abs(values[""] - error_mrad) <= room, (name, t_s, values, of)
            errors += 1
    assert angles > 100 and errors > 60 and len(moved) > 40, (angles, errors, len(moved))
    for title, rows in looks.items():
        assert all(values for _, values in rows), title
        # Only the heading of a chart with a single curve stands for its name.
        assert all(len(values) == 1 for _, values in rows if "" in values), title
    print(f"{len(looks)} charts, {angles} angles and {errors} errors under the pointer as in recording and plan")


def look(page, report, folder):
    """Time and values under the pointer, for each chart over time by its heading."""
    page.order("Page.enable")
    page.order("Runtime.enable")
    page.show(1280, 1000, dark=False)
    page.order("Page.navigate", url=report.resolve().as_uri())
    page.value("new Promise(done => document.readyState === 'complete' ? done() : addEventListener('load', done))")
    page.value("document.querySelectorAll('details').forEach(folded => { folded.open = true; })")
    looks = {}
    for i, title in enumerate(page.value(CHARTS)):
        left, width, y, x0, x1 = page.value(FRAME % i)
        for place in PLACES:
            page.point_at(left + place * width, y)
            tip = page.value(TIP % i)
            t_s, values = told(tip)
            # A sample every few ms where the pointer is; plans are told in steps of a hundredth of their length.
            assert abs(t_s - (x0 + place * (x1 - x0))) <= 0.05 * (x1 - x0), (title, tip)
            looks.setdefault(title, []).append((t_s, values))
        if i == 0:
            page.picture(folder / "report_pointer.png", whole=False)
    return looks


main(*sys.argv[1:])
