"""Points at charts of a report in a real browser, and holds what is shown under the pointer against recording and plan.

    check_report.py CUBECTL OUT      pictures, throw and report go into the folder OUT

Of each joint the angle of the sample under the pointer must be one that its drive reported at that time of the plan, the reference must
be that of the plan file, the error must be the difference of the two. A drag enlarges a part of a chart.
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


def reported(tip):
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


def drawing(page):
    """What the script draws of data made for it: ticks, legend, frame, marks."""
    chart = "chart({title: 'heading', x_label: '', y_label: '', ...%s}).svg"
    curve = lambda points, **more: {"name": "", "colour": 0, "pen": "line", "points": points, "beside": False, **more}
    drawn = lambda **data: page.value(f"{chart % json.dumps(data)}.outerHTML")
    frame = lambda **data: page.value(f"{chart % json.dumps({**data, 'time': True})}.dataset.time.split(' ').map(Number)")
    line = [[0, 0], [1, 1]]
    assert page.value("ticks(-0.11, 0.32).map(tick => tick[1])") == ["−0.1", "0.0", "0.1", "0.2", "0.3"]
    assert page.value("ticks(0, 1e-15).length") < 41, "a span of nothing ends too"
    # A legend that is too long goes on in a row below, and the chart grows by it.
    names = ["actual", "flight", "accelerate", "follow the parabola", "decelerate"]
    places = page.value(f"legend({json.dumps([curve(line, name=name) for name in names])}, 400)")
    assert [row for _, row in places] == [0, 0, 0, 0, 1], places
    assert all(x + 20 + 6.2 * len(name) <= 400 for (x, _), name in zip(places, names)), places
    heights = [re.search(r'viewBox="0 0 400 ([0-9.]+)"', drawn(curves=[curve(line, name=name) for name in some]))[1] for some in [names[:1], names]]
    assert heights == ["236", "251"], heights
    # Long numbers of the vertical axis leave room for its name.
    lefts = [frame(curves=[curve([[0, 3.1211], [1, 3.1211 + high]])])[2] for high in [1, 0.0004]]
    assert lefts[0] == 58 and abs(lefts[1] - (27 + 6.2 * 6)) < 1e-9, lefts
    # A fault just after the last sample is marked, a distant one is not; nor is an event outside the curves.
    for at, span in [(0.5, [0, 1]), (1.01, [0, 1.05]), (3, [0, 1])]:
        data = {"curves": [curve(line)], "fault": [at, "fault 104"]}
        assert frame(**data)[:2] == span and ("fault 104" in drawn(**data)) == (at < 3), at
    shows = lambda at: ">release<" in drawn(curves=[curve([[0, 1], [0.5, 2]])], mark=[at, "release"])
    assert shows(0.4) and not shows(0.7)
    late = drawn(curves=[curve(line)], mark=[0.4, "release"], fault=[0.95, "fault"])
    assert re.search(r'text-anchor="start"[^>]*>release<', late) and re.search(r'text-anchor="end"[^>]*>fault<', late), "both inside"
    # A curve beside does not set the frame and is not drawn outside it.
    near, far = [[0, 0], [1, 1], [2, 0.5]], [[0, 3], [0.5, 0.2], [1, 0.4], [1.5, -3], [2, 0.3]]
    curves = [curve(near), curve(far, beside=True)]
    assert frame(curves=curves[:1]) == frame(curves=curves)
    path = re.findall(r'class="c s0" d="([^"]*)"', drawn(curves=curves))[1]
    assert (path.count("M"), path.count("L")) == (2, 1), path
    # No points, points that are no numbers, markup in a name.
    odd = drawn(title="a < b", curves=[curve([[0, None], [1, 2], [None, 1], [2, 3]], name="<img src=x>"), curve([])])
    assert "NaN" not in odd and "Infinity" not in odd and "<img" not in odd and "a &lt; b" in odd, odd


def enlarge(page, i):
    """A drag of the mouse across a chart shows that part, a double click all of it; the vertical axis fits what is shown."""
    left, width, y, x0, x1 = page.value(FRAME % i)
    span = lambda: page.value(FRAME % i)[3:]
    mouse = lambda kind, place, clicks=1: page.order(
        "Input.dispatchMouseEvent", type=kind, x=left + place * width, y=y, button="left", clickCount=clicks)
    for kind, place in [("mousePressed", 0.25), ("mouseMoved", 0.5), ("mouseReleased", 0.75)]:
        mouse(kind, place)
    a, b = span()
    assert abs(a - (x0 + 0.25 * (x1 - x0))) < 0.02 * (x1 - x0) and abs(b - (x0 + 0.75 * (x1 - x0))) < 0.02 * (x1 - x0), (a, b, x0, x1)
    for clicks in [1, 2]:
        mouse("mousePressed", 0.5, clicks)
        mouse("mouseReleased", 0.5, clicks)
    assert span() == [x0, x1], (span(), x0, x1)


def landing(page):
    """A chart that is not over time names the point under the pointer."""
    x, y = page.value("""(() => { const svg = [...document.querySelectorAll('svg')].find(svg => svg.getAttribute('aria-label').startsWith('Landing'));
      svg.scrollIntoView({block: 'center'});
      const box = svg.querySelector('path.c.dash').getBoundingClientRect(); return [box.right - 1, box.top + box.height / 2]; })()""")
    page.point_at(x, y)
    return page.value("[...document.querySelectorAll('.tip')].map(tip => tip.textContent).filter(text => text)")


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
            t_s, values = reported(tip)
            # A sample every few ms where the pointer is; plans are shown in steps of a hundredth of their length.
            assert abs(t_s - (x0 + place * (x1 - x0))) <= 0.05 * (x1 - x0), (title, tip)
            looks.setdefault(title, []).append((t_s, values))
        if i == 0:
            page.picture(folder / "report_pointer.png", whole=False)
            enlarge(page, i)
    drawing(page)
    reported_there = landing(page)
    assert len(reported_there) == 1 and reported_there[0].startswith("2σ "), reported_there
    return looks


main(*sys.argv[1:])
