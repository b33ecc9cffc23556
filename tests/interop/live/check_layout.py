"""Looks at every kind of report in a real browser: what its first screen says, how long it is, how its letters look, how it prints.

    check_layout.py CUBECTL OUT      pictures, papers and reports go into the folder OUT

Every text and every curve of the data is in the page, and texts from outside are no markup. The first screen of a desktop and of a
phone says whether, why and what next. With all parts folded a report is at most 2500 px high on a desktop and 4000 px on a phone. Text that is no heading and no figure has one size, and all text a contrast of 4.5. On paper it has
at most four pages, in light colours from a dark screen too, and if more than one none of them is half empty.
"""

import base64
import io
import pathlib
import re
import subprocess
import sys

import pypdfium2

from browser import Page

SCENARIOS = pathlib.Path(__file__).parents[3] / "hil-sim" / "scenarios"
PROGRAM = """schema_version = 1
robot = "powercube6"
[[step]]
by = "1=0.3"
[[step]]
by = "1=-0.3"
"""
SCREENS = [("desktop", 1280, 800, False, 2500), ("dark", 1280, 800, True, 2500), ("phone", 390, 844, False, 4000)]
ANSWER = "[...document.querySelectorAll('.answer > *')].map(part => part.textContent)"
ANSWER_ENDS = "document.querySelector('.answer').getBoundingClientRect().bottom + scrollY"
# Of each text that is seen: size in px, contrast with what is behind it, the text. Letters in charts are drawn, not set.
TEXTS = """(() => {
  const numbers = text => text.match(/[0-9.]+/g).map(Number);
  const light = text => { const [r, g, b] = numbers(text).map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const clear = text => numbers(text)[3] === 0;
  const found = [], walk = document.createTreeWalker(document.querySelector('main'), NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const parent = walk.currentNode.parentElement, style = getComputedStyle(parent);
    if (!walk.currentNode.data.trim() || !parent.checkVisibility({contentVisibilityAuto: true}) || parent.closest('svg, h1, h2, option, .tile b')) continue;
    let ground = parent; while (clear(getComputedStyle(ground).backgroundColor)) ground = ground.parentElement;
    const [a, b] = [light(style.color), light(getComputedStyle(ground).backgroundColor)].sort((a, b) => b - a);
    found.push([parseFloat(style.fontSize), (a + 0.05) / (b + 0.05), walk.currentNode.data.trim()]);
  }
  return found; })()"""

# What of the data is not in the page: headings, texts and cells by their text, charts by their curves with points. And what is in it that
# no report has.
NOT_DRAWN = """(() => {
  const clean = text => text.replaceAll('`', '').replaceAll('\\u00a0', ' ').replace(/\\s+/g, ' ').trim();
  const page = clean(document.querySelector('main').textContent), missing = [], charts = [];
  const walk = value => {
    if (value === null || typeof value !== 'object') { if (typeof value === 'string' && !page.includes(clean(value))) missing.push(value); return; }
    if (value.curves) charts.push(value);
    for (const [key, inner] of Object.entries(value)) if (!['fold', 'tone', 'pen', 'scene', 'frames', 'summary', 'cells', 'version', 'mark', 'fault'].includes(key)) walk(inner);
  };
  walk([data.title, data.under, data.answer.verdict, data.answer.why, data.answer.next, data.parts.map(part => [part.heading, part.about])]);
  const tables = data.parts.flatMap(part => part.blocks).flatMap(block => block.beside || [block]);
  walk(tables.map(block => block.table ? [block.table.head, block.table.rows.map(row => row.map(cell => cell[0]))] : block));
  const drawn = [...document.querySelectorAll('svg[aria-label]')].map(svg => svg.getAttribute('aria-label'));
  for (const chart of charts) {
    const svg = document.querySelectorAll('svg[aria-label]')[drawn.indexOf(chart.title)], points = chart.curves.filter(curve => curve.points.some(p => p[0] !== null && p[1] !== null));
    const paths = svg ? svg.querySelectorAll('path.c, path.limit').length : 0;
    if (paths < points.length) missing.push(`${chart.title}: ${paths} of ${points.length} curves`);
  }
  return [missing, document.querySelectorAll('main :is(img, script, iframe, object)').length]; })()"""
INK_ON_PAPER = """(() => { dispatchEvent(new Event('beforeprint'));
  const ink = getComputedStyle(document.documentElement).getPropertyValue('--ink').trim();
  dispatchEvent(new Event('afterprint')); return ink; })()"""


def reports(cubectl, folder):
    """A report of each kind, by its name."""
    def run(*words, codes=(0,), program=cubectl):
        done = subprocess.run([program, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert done.returncode in codes, (words, done.stderr)

    at = lambda name: str(folder / name)
    run("throw", "--target", "1.0,1.0,-1.0", "--seed", "6", "--out", at("throw"))
    # A joint does not answer.
    run("throw", "--target", "1.0,1.0,-1.0", "--scenario", str(SCENARIOS / "silent_joint.toml"), "--out", at("fault"), codes=(13,))
    run("move", "--by", "1=0.5", "--home", "--out", at("move"))
    # The arm is not where this plan begins.
    run("run", at("throw/plan.json"), "--home", "--out", at("refused"), codes=(8,))
    run("plan", "throw", "--target", "1.0,1.0,-1.0", "--out", at("plan.json"), "--report", at("plan.html"))
    run("catch", "--robot", "powercube6", "--ball", "2.2,0.1,0.4,-2.6,-0.1,3.0", "--report", at("ball.html"))
    run("catch", "--robot", "pincher4", "--disc", "flat", "--report", at("disc.html"))
    run("arm", "identify", "--joint", "2", "--home", "--report", at("identify.html"))
    run("plan", "throw", "--robot", "kr16_2", "--target", "2.5,0,0.54", "--starts", "2", "--out", at("follow.json"), "--report", at("follow.html"))
    run("throw", "--robot", "kr16_2", "--plan", at("follow.json"), "--out", at("industrial"))
    run("tune", "--plan", at("throw/plan.json"), "--out", at("gains.toml"), "--report", at("tune.html"))
    run("rally", "--throws", "1", "--report", at("rally.html"), program=pathlib.Path(cubectl).with_name("cubelab"))
    # Names from outside are texts, whatever stands in them.
    program = folder / "<img src=x onerror=alert(1)>'\"&`.toml"
    program.write_text(PROGRAM)
    run("run", str(program), "--home", "--repeat", "3", "--out", at("program"))
    run("robot", "show", "powercube6", "--out", at("robot.html"))
    run("plan", "sweep", "--x=1,5,2", "--y=0.5,0.5,1", "--z=-1,-1,1", "--fast", "--starts", "2", "--out", at("sweep"))
    run("plan", "sweep", "--summary", at("sweep"), "--picture", at("reach.html"))
    for name in ["throw", "fault", "move", "refused", "industrial", "program"]:
        yield name, folder / name / "report.html"
    for name in ["plan", "ball", "disc", "identify", "follow", "tune", "rally", "robot", "reach"]:
        yield name, folder / f"{name}.html"


def look(page, name, file, folder):
    page.order("Page.navigate", url=file.resolve().as_uri())
    page.value("new Promise(done => document.readyState === 'complete' ? done() : addEventListener('load', done))")
    for screen, width, height, dark, high_max in SCREENS:
        page.show(width, height, dark)
        page.picture(folder / f"{name}_{screen}.png")
        high, wide = page.value("[document.documentElement.scrollHeight, document.documentElement.scrollWidth]")
        assert high <= high_max and wide <= width, (name, screen, high, wide)
        verdict, why, because, next_, do = page.value(ANSWER)
        assert (why, next_) == ("Why", "Next") and all([verdict, because, do]), (name, page.value(ANSWER))
        assert page.value(NOT_DRAWN) == [[], 0], (name, page.value(NOT_DRAWN))
        assert page.value(ANSWER_ENDS) <= height, (name, screen, "the answer is not on the first screen")
        for folded in [True, False]:
            page.value(f"document.querySelectorAll('details').forEach(part => {{ part.open = {str(not folded).lower()}; }})")
            texts = page.value(TEXTS)
            assert len(texts) > 8, (name, texts)
            assert {size for size, _, _ in texts} == {14}, (name, screen, [text for text in texts if text[0] != 14])
            faint = [text for text in texts if text[1] < 4.5]
            assert not faint, (name, screen, faint)
        page.value("document.querySelectorAll('details').forEach(part => { part.open = false; })")


def paper(page, name, folder):
    """From a dark desktop or phone: filled alike, and the outcome and the letters of the picture in space are dark on white."""
    for width, height in [(1280, 1000), (390, 844)]:
        page.show(width, height, dark=True)
        data = base64.b64decode(page.order("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)["data"])
        (folder / f"{name}.pdf").write_bytes(data)
        filled = [ends(sheet) for sheet in pypdfium2.PdfDocument(io.BytesIO(data))]
        assert len(filled) == 1 or len(filled) <= 4 and min(filled) > 0.5, (name, width, filled)
    assert page.value(INK_ON_PAPER) == "#16181d", (name, "letters of the picture in space")
    page.show(1280, 1000, dark=False)
    page.order("Emulation.setEmulatedMedia", media="print")
    outcome = page.value("(pill => pill.color + ' ' + pill.backgroundColor)(getComputedStyle(document.querySelector('.pill')))")
    page.order("Emulation.setEmulatedMedia", media="")
    colour, background = re.findall(r"rgba?\(([^)]*)\)", outcome)
    assert sum(float(part) for part in colour.split(",")[:3]) < 450 and background == "0, 0, 0, 0", (name, outcome)
    print(f"{name}: pages on paper filled to", ", ".join(f"{share:.0%}" for share in filled))


def ends(sheet):
    """Share of the sheet above its last mark."""
    bitmap = sheet.render(scale=0.5, grayscale=True)
    rows = [bytes(bitmap.buffer)[y * bitmap.stride : y * bitmap.stride + bitmap.width] for y in range(bitmap.height)]
    return max((y for y, row in enumerate(rows) if min(row) < 200), default=0) / bitmap.height


def main(cubectl, out):
    folder = pathlib.Path(out)
    page = Page(folder)
    try:
        page.order("Page.enable")
        page.order("Runtime.enable")
        for name, file in reports(cubectl, folder):
            look(page, name, file, folder)
            paper(page, name, folder)
    finally:
        page.browser.kill()


main(*sys.argv[1:])
