// Charts: curves in one frame, as SVG from their data. All charts over time show one present time; the pointer reads values.
const CHAR = 6.2, LEGEND_ROW = 15, FAULT_BEYOND = 0.05;
const minus = text => String(text).replaceAll('-', '−'), digits4 = value => minus(Number(value.toPrecision(4)));
const isPoint = p => p[0] !== null && p[1] !== null;

// Round numbers from `lo` to `hi` with their labels: steps of 1, 2 or 5 times a power of ten.
function ticks(lo, hi) {
  const raw = Math.max((hi - lo) / 5, 1e-12), power = 10 ** Math.floor(Math.log10(raw)), step = ([1, 2, 5].find(d => d * power >= raw) ?? 10) * power;
  const digits = Math.max(0, -Math.floor(Math.log10(step))), first = Math.ceil(lo / step), found = [];
  for (let i = 0; i < 40 && (first + i) * step <= hi + 1e-9 * step; i++) {
    const value = Math.abs(first + i) < 1e-9 ? 0 : (first + i) * step;
    found.push([value, minus(value.toFixed(digits))]);
  }
  return found;
}
// Left end and row of each name in the legend; a row that is full is followed by another.
function legend(curves, width) {
  let x = 0, row = 0;
  return curves.map(({name, points}) => {
    const length = name && points.some(isPoint) ? 30 + CHAR * name.length : 0;
    if (x > 0 && x + length - 10 > width) { x = 0; row += 1; }
    x += length;
    return [x - length, row];
  });
}
// Where the frame stands and what it shows. `span` is the part of x that is shown; curves `beside` have no say.
function frameOf({curves, band, y_at_least, fault, equal, span}, width, h, more) {
  let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
  const see = ([x, y]) => { x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y); };
  const inside = p => isPoint(p) && (!span || p[0] >= span[0] && p[0] <= span[1]);
  for (const curve of curves) if (!curve.beside) for (const p of curve.points) if (inside(p)) see(p);
  if (band) { const [a, b, c, d] = band; see([a, c]); see([b, d]); }
  if (x0 > x1) [x0, x1, y0, y1] = [0, 1, y_at_least ? Infinity : 0, y_at_least ? -Infinity : 1];
  if (y_at_least) { y0 = Math.min(y0, y_at_least[0]); y1 = Math.max(y1, y_at_least[1]); }
  // What is recorded may end just before the fault that ended it.
  const near = FAULT_BEYOND * (x1 - x0);
  if (fault && fault[0] >= x1 && fault[0] <= x1 + near) x1 += near;
  const pad = d => d < 1e-9 ? 0.5 : 0.06 * d, px = equal || x1 - x0 < 1e-9 ? pad(x1 - x0) : 0, py = pad(y1 - y0);
  [x0, x1, y0, y1] = [x0 - px, x1 + px, y0 - py, y1 + py];
  if (span) [x0, x1] = span;
  // Numbers of the vertical axis stand beside its name.
  const left = 27 + CHAR * Math.max(5, ...ticks(y0, y1).map(([, label]) => label.length)), top = 46 + more, w = width - left - 14;
  if (equal) {
    const scale = Math.max((x1 - x0) / w, (y1 - y0) / h), cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
    [x0, x1, y0, y1] = [cx - scale * w / 2, cx + scale * w / 2, cy - scale * h / 2, cy + scale * h / 2];
  }
  return {left, top, w, h, x0, x1, y0, y1, sx: x => left + (x - x0) / (x1 - x0) * w, sy: y => top + (y1 - y) / (y1 - y0) * h};
}
function curveNodes({name, colour, pen, points}, f, [legendX, row]) {
  let d = '', up = true; const dots = [], y = 29 + LEGEND_ROW * row;
  const dot = (cx, cy) => svgEl('circle', {class: `f${colour}`, cx, cy, r: 1.8});
  for (const p of points) {
    if (!isPoint(p) || p[0] < f.x0 || p[0] > f.x1 || p[1] < f.y0 || p[1] > f.y1) { up ||= isPoint(p); continue; }
    const [sx, sy] = [f.sx(p[0]).toFixed(1), f.sy(p[1]).toFixed(1)];
    d += `${up ? 'M' : 'L'}${sx} ${sy}`; up = false;
    if (pen === 'dots' || pen === 'marks') dots.push(dot(sx, sy));
  }
  const style = {line: `c s${colour}`, dashed: `c dash s${colour}`, dots: `c dots s${colour}`, marks: 'c', limit: 'limit'}[pen];
  const nodes = [svgEl('path', {class: style, d}), ...dots];
  if (name) nodes.push(svgEl('path', {class: style, d: `M${legendX.toFixed(1)} ${y}h16`}), svgEl('text', {x: (legendX + 20).toFixed(1), y: y + 4}, name));
  if (name && dots.length) nodes.push(dot((legendX + 8).toFixed(1), y));
  return nodes;
}
const charts = [];
// A chart of `width` with a frame `h` high; its data may be changed and drawn again. With `origin`, x is counted from there.
function chart(data, width = 400, h = data.equal ? 316 : 152) {
  const svg = svgEl('svg', {role: 'img', 'aria-label': data.title}), mark = svgEl('path', {class: 'now'}), tip = svgEl('text', {class: 'tip'});
  const text = (x, y, words, anchor, style) => svgEl('text', {x: x.toFixed(1), y: y.toFixed(1), 'text-anchor': anchor, class: style}, words);
  const path = (style, d) => svgEl('path', {class: style, d});
  // A chart of what comes has its own time, and is not enlarged.
  const isShared = data.time && data.origin === undefined;
  let f, pointer = null, pressed = null;
  function draw() {
    const places = legend(data.curves, width), more = LEGEND_ROW * (places.at(-1)?.[1] ?? 0), origin = data.origin ?? 0;
    f = frameOf(data, width, h, more);
    const {left, top, w} = f, below = top + h, right = left + w, nodes = [text(0, 14, data.title, undefined, 't')];
    svg.setAttribute('viewBox', `0 0 ${width} ${below + 38}`);
    if (data.time) svg.dataset.time = [f.x0, f.x1, left, w, top, h].join(' ');
    if (data.band) {
      const [a, b, c, d] = data.band, x = Math.max(left, f.sx(a));
      nodes.push(svgEl('rect', {class: 'band', x, y: f.sy(d), width: Math.max(0, Math.min(right, f.sx(b)) - x), height: f.sy(c) - f.sy(d)}));
    }
    for (const [tick, label] of ticks(f.x0 - origin, f.x1 - origin)) {
      const x = f.sx(tick + origin), now = data.origin !== undefined && tick === 0;
      nodes.push(path('g', `M${x.toFixed(1)} ${top}V${below}`), text(x, below + 15, now ? 'now' : label, 'middle'));
    }
    for (const [tick, label] of ticks(f.y0, f.y1)) {
      const y = f.sy(tick);
      nodes.push(path(tick === 0 ? 'z' : 'g', `M${left} ${y.toFixed(1)}H${right.toFixed(1)}`), text(left - 6, y + 4, label, 'end'));
    }
    nodes.push(text(left + w / 2, below + 34, data.x_label, 'middle'),
      svgEl('text', {transform: `translate(12 ${(top + h / 2).toFixed(1)}) rotate(-90)`, 'text-anchor': 'middle'}, data.y_label));
    data.curves.forEach((curve, i) => nodes.push(...curveNodes(curve, f, places[i])));
    for (const [[x, y], words] of data.labels ?? []) nodes.push(text(f.sx(x) + 5, f.sy(y) + 13, words, 'start', 'e'));
    for (const [at, style, down] of [[data.mark, 'm', 11], [data.fault, 'm fault', 24]]) {
      // Points are of single precision, the place of a mark is not.
      const room = 1e-6 * (f.x1 - f.x0);
      if (!at || at[0] < f.x0 - room || at[0] > f.x1 + room) continue;
      const x = f.sx(at[0]), isRight = x > left + 0.8 * w;
      nodes.push(path(style, `M${x.toFixed(1)} ${top}V${below}`), text(x + (isRight ? -4 : 4), top + down, at[1], isRight ? 'end' : 'start', 'e'));
    }
    svg.replaceChildren(...nodes, mark, tip);
    if (pointer !== null) show(f.x0 + pointer * (f.x1 - f.x0), true);
  }
  // Lines of text at the foot of the frame, as much in each as its width holds.
  function tell(head, parts) {
    const lines = [head];
    for (const part of parts) {
      if ((lines.at(-1).length + part.length + 2) * CHAR > f.w) lines.push(part);
      else lines[lines.length - 1] += (lines.at(-1).endsWith(':') ? ' ' : ', ') + part;
    }
    tip.replaceChildren(...lines.map((line, i) => svgEl('tspan', {x: f.left + 4, y: f.top + h - 5 - 14 * (lines.length - 1 - i)}, line)));
  }
  const read = () => data.curves.filter(curve => curve.pen !== 'limit' && curve.points.some(isPoint));
  // The point of a curve that is nearest to a time; a curve may have none there.
  function nearest({points}, t) {
    let best = null;
    for (const p of points) if (isPoint(p) && (!best || Math.abs(p[0] - t) < Math.abs(best[0] - t))) best = p;
    return best && Math.abs(best[0] - t) < 0.05 * (f.x1 - f.x0) && best[1] >= f.y0 && best[1] <= f.y1 ? best : null;
  }
  function show(t, values) {
    tip.replaceChildren();
    if (t < f.x0 || t > f.x1) { mark.setAttribute('d', ''); return; }
    mark.setAttribute('d', `M${f.sx(t).toFixed(1)} ${f.top}V${f.top + h}`);
    if (!values) return;
    const points = read().map(curve => [curve.name, nearest(curve, t)]), seen = points.map(([, p]) => p).filter(p => p);
    const at = seen.reduce((best, p) => Math.abs(p[0] - t) < Math.abs(best - t) ? p[0] : best, seen[0]?.[0] ?? t);
    tell(`${minus(at.toFixed(3))} s:`, points.map(([name, p]) => `${name} ${p ? digits4(p[1]) : '–'}`.trim()));
  }
  // Of a chart that is not over time, the point nearest to the pointer.
  function point(px, py) {
    let best = null, apart = 20;
    for (const {name, points} of read()) for (const p of points) {
      const away = isPoint(p) ? Math.hypot(f.sx(p[0]) - px, f.sy(p[1]) - py) : Infinity;
      if (away < apart) { apart = away; best = [name, p]; }
    }
    if (best) tell(`${best[0]} ${digits4(best[1][0])}, ${digits4(best[1][1])}`.trim(), []); else tip.replaceChildren();
  }
  const place = e => { const box = svg.getBoundingClientRect(), k = width / box.width; return [(e.clientX - box.left) * k, (e.clientY - box.top) * k]; };
  const share = e => (place(e)[0] - f.left) / f.w;
  svg.addEventListener('pointermove', e => {
    if (!data.time) { point(...place(e)); return; }
    pointer = share(e); if (pointer < 0 || pointer > 1) { pointer = null; return; }
    const t = f.x0 + pointer * (f.x1 - f.x0);
    if (!isShared) { show(t, true); return; }
    charts.forEach(one => one.show(t, one.svg === svg)); dispatchEvent(new CustomEvent('chart-time', {detail: t}));
  });
  svg.addEventListener('pointerleave', () => { pointer = pressed = null; tip.replaceChildren(); });
  // A mouse that is drawn across enlarges what it passes.
  svg.addEventListener('pointerdown', e => { pressed = e.pointerType === 'mouse' && !data.equal && data.origin === undefined ? share(e) : null; });
  svg.addEventListener('pointerup', e => {
    const [a, b] = [pressed ?? 0, pressed === null ? 0 : share(e)].map(s => Math.max(0, Math.min(1, s))).sort((a, b) => a - b);
    pressed = null;
    if (b - a > 0.02) { data.span = [f.x0 + a * (f.x1 - f.x0), f.x0 + b * (f.x1 - f.x0)]; draw(); }
  });
  svg.addEventListener('dblclick', () => { if (data.origin === undefined) { delete data.span; draw(); } });
  draw();
  const made = {svg, data, draw, show, pointed: () => pointer !== null};
  if (isShared) charts.push(made);
  return made;
}
addEventListener('plan-time', e => charts.forEach(one => one.show(e.detail, one.pointed())));
