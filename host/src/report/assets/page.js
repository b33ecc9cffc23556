// A report: the data in the page becomes headings, tiles, tables, charts and pictures. Texts are set as text, never read as markup.
const filled = (node, attributes, children) => {
  for (const [key, value] of Object.entries(attributes || {})) if (value !== undefined && value !== '') node.setAttribute(key, value);
  node.append(...children.flat(Infinity).filter(child => child !== null && child !== undefined));
  return node;
};
const el = (name, attributes, ...children) => filled(document.createElement(name), attributes, children);
const svgEl = (name, attributes, ...children) => filled(document.createElementNS('http://www.w3.org/2000/svg', name), attributes, children);
const data = JSON.parse(document.getElementById('data').textContent);
// What stands between backticks is code.
const marked = text => text.split('`').map((part, k) => k % 2 ? el('code', {}, part) : part);
const paragraph = (text, attributes) => text ? el('p', attributes, marked(text)) : null;
const card = child => el('figure', {class: 'card'}, child);

function tiles(all) {
  return el('div', {class: 'tiles'}, all.map(({value, unit, what, tone, id}) => el('div', {class: 'tile'},
    el('b', {class: tone, id}, value, unit ? el('small', {}, unit) : null), el('span', {}, what.replaceAll(' %', '\u00a0%')))));
}
// A column whose cells are mostly words stands to the left, and so does the first.
function table({head, rows}) {
  const isText = column => {
    const cells = rows.map(row => row[column]?.[0]).filter(Boolean);
    return 2 * cells.filter(text => (text.match(/\p{L}/gu) || []).length > 3).length > cells.length;
  };
  const left = head.map((_, i) => i === 0 || isText(i) ? 'l' : '');
  const body = rows.map(row => el('tr', {}, row.map(([text, tone], i) => el('td', {class: `${left[i]} ${tone}`.trim()}, text))));
  return el('div', {class: 'card scroll'}, el('table', {},
    el('thead', {}, el('tr', {}, head.map((name, i) => el('th', {class: left[i]}, name)))), el('tbody', {}, body)));
}
const later = [];
function space({scene, beside}) {
  const option = (value, text) => el('option', {value, selected: value === 0.25 ? 'selected' : undefined}, text);
  const bar = el('div', {class: 'bar'}, el('button', {id: 'play'}, 'Play'),
    el('select', {id: 'speed', 'aria-label': 'speed'}, option(1, '1 ×'), option(0.25, '¼ ×'), option(0.05, '1/20 ×')),
    el('input', {id: 'time', type: 'range', min: 0, max: 1000, value: 0, 'aria-label': 'time'}), el('output', {id: 'shown'}), VIEWS());
  later.push(() => inSpace(scene));
  return el('div', {class: 'scene'},
    el('figure', {class: 'card'}, el('canvas', {id: 'scene', 'aria-label': 'arm, hand path and flight'}), bar), beside ? card(chart(beside).svg) : null);
}
const VIEWS = () => [el('button', {id: 'reset'}, 'Reset'), el('button', {id: 'top'}, 'From above')];

// Frames on the bus: a lane for each drive, one for broadcasts, one for the host link.
const FRAMES = {request: 0, answer: 2, broadcast: 1, 'host link': 3, foreign: 7};
function timeline({from_ms, to_ms, lanes, frames}) {
  const WIDE = 1200, LEFT = 120, LANE = 24, TOP = 26, TICKS_MAX = 25, w = WIDE - LEFT - 8, floor = TOP + LANE * lanes.length;
  const sx = ms => LEFT + (ms - from_ms) / (to_ms - from_ms) * w, one = digits => value => value.toFixed(digits);
  const text = (x, y, words, anchor) => svgEl('text', {x: x.toFixed(1), y: y.toFixed(1), 'text-anchor': anchor}, String(words));
  const nodes = Object.entries(FRAMES).slice(0, 4).flatMap(([name, colour], i) =>
    [svgEl('rect', {class: `f${colour}`, x: LEFT + 110 * i, y: 4, width: 12, height: 11, rx: 2}), text(LEFT + 110 * i + 17, 14, name)]);
  lanes.forEach((name, row) => nodes.push(svgEl('path', {class: 'g', d: `M${LEFT} ${TOP + LANE * (row + 1)}H${LEFT + w}`}),
    text(LEFT - 8, TOP + LANE * row + 16, name, 'end')));
  // The fewest steps of 1, 2 or 5 times a power of ten whose numbers do not touch.
  let step = 1; while (to_ms - from_ms > TICKS_MAX * step) step *= /^2/.test(step) ? 2.5 : 2;
  for (let ms = Math.ceil(from_ms / step) * step; ms <= to_ms; ms += step) nodes.push(
    svgEl('path', {class: 'g', d: `M${sx(ms).toFixed(1)} ${TOP}V${floor}`}), text(sx(ms), floor + 14, ms, 'middle'));
  nodes.push(text(LEFT + w / 2, floor + 30, 'time of the plan in ms', 'middle'));
  for (const {lane, kind, from, to, what} of frames) {
    const a = sx(Math.max(from, from_ms)), b = sx(Math.min(to, to_ms));
    nodes.push(svgEl('rect', {class: `f${FRAMES[kind]}`, x: a.toFixed(2), y: TOP + LANE * lane + 4, width: Math.max(b - a - 0.6, 0.8).toFixed(2), height: LANE - 7, rx: 1.5},
      svgEl('title', {}, `${from.toFixed(3)} ms to ${to.toFixed(3)} ms: ${what}`)));
  }
  return el('figure', {class: 'card timeline'}, svgEl('svg', {viewBox: `0 0 ${WIDE} ${floor + 34}`, role: 'img', 'aria-label': 'frames on the bus'}, nodes));
}

// Cells with a colour by their value: dark blue through green to yellow, brighter with it, so that it survives grey print.
function map({x_label, y_label, step, cells}) {
  const values = cells.map(cell => cell.value).filter(value => value !== null), best = Math.min(...values), worst = Math.max(...values);
  const colour = value => { const t = worst > best ? (value - best) / (worst - best) : 0; return `hsl(${240 - 185 * t} 65% ${32 + 36 * t}%)`; };
  const axes = [0, 1].map(i => [...new Set(cells.map(cell => cell.at[i]))].sort((a, b) => a - b)), [xs, ys] = axes, LEFT = 60, TOP = 8;
  const [wide, high] = axes.map((axis, i) => axis.at(-1) - axis[0] + step[i]), scale = 640 / Math.max(wide, 0.6 * high), w = wide * scale, h = high * scale;
  const sx = x => LEFT + (x - xs[0]) * scale, sy = y => TOP + h - (y - ys[0] + step[1]) * scale, grey = 'var(--line)';
  const text = (x, y, words, anchor) => svgEl('text', {x, y, 'text-anchor': anchor}, words), rect = (x, y, width, height, fill, ...inner) => svgEl('rect', {x, y, width, height, style: `fill:${fill}`}, inner);
  const nodes = cells.map(({at: [x, y], value, target}) => rect(sx(x), sy(y), step[0] * scale - 0.5, step[1] * scale - 0.5, value === null ? grey : colour(value),
    svgEl('title', {}, `(${target.join(', ')}) m: ${value === null ? 'no throw' : value.toFixed(2)}`)));
  // Every this many cells has its value beside it.
  const named = axis => axis.filter((_, i) => i % Math.ceil(axis.length / 10) === 0);
  named(xs).forEach(x => nodes.push(text(sx(x) + step[0] * scale / 2, TOP + h + 16, x.toFixed(2), 'middle')));
  named(ys).forEach(y => nodes.push(text(LEFT - 6, sy(y) + step[1] * scale / 2 + 4, y.toFixed(2), 'end')));
  const key = values.length ? [0, 1, 2, 3, 4, 5].map(i => best + i / 5 * (worst - best)) : [];
  [...key, null].forEach((value, i) => nodes.push(rect(LEFT + w + 16, TOP + 20 * i, 16, 16, value === null ? grey : colour(value)),
    text(LEFT + w + 38, TOP + 20 * i + 12, value === null ? 'no throw' : value.toFixed(1))));
  nodes.push(text(LEFT + w / 2, TOP + h + 38, x_label, 'middle'),
    svgEl('text', {transform: `translate(14 ${TOP + h / 2}) rotate(-90)`, 'text-anchor': 'middle'}, y_label));
  return card(svgEl('svg', {viewBox: `0 0 ${LEFT + w + 120} ${TOP + h + 46}`, role: 'img', 'aria-label': 'reach'}, nodes));
}

// A document as tables: the values at its top in one, then one for each group; a list of objects has a column for each key.
function summary(all) {
  const words = key => key.replaceAll('_', ' '), isObject = value => value !== null && typeof value === 'object' && !Array.isArray(value);
  const plain = value => value === null || value === undefined ? '' : typeof value === 'number' ? String(Number.isInteger(value) ? value : Number(value.toPrecision(6)))
    : Array.isArray(value) ? value.map(plain).join(value.some(item => typeof item === 'object') ? '; ' : ', ') : isObject(value) ? JSON.stringify(value) : String(value);
  const flat = (map, path) => Object.entries(map).filter(([, value]) => value !== null).flatMap(([key, value]) =>
    isObject(value) ? flat(value, `${path}${key}: `) : [[[words(path + key), ''], [plain(value), '']]]);
  const listed = (name, items) => {
    const keys = [...new Set(items.flatMap(Object.keys))], isNamed = key => items.every(item => typeof item[key] === 'string');
    keys.sort((a, b) => isNamed(b) - isNamed(a));
    return table({head: keys.map((key, i) => (i ? '' : `${words(name)}: `) + words(key)), rows: items.map(item => keys.map(key => [plain(item[key]), '']))});
  };
  const isGroup = value => isObject(value) || Array.isArray(value) && value.some(isObject);
  const entries = Object.entries(all), single = Object.fromEntries(entries.filter(([, value]) => !isGroup(value)));
  return el('div', {class: 'two'}, table({head: ['run', 'value'], rows: flat(single, '')}), entries.filter(([, value]) => isGroup(value)).map(([key, value]) =>
    Array.isArray(value) ? listed(key, value.filter(isObject)) : table({head: [words(key), 'value'], rows: flat(value, '')})));
}

const BLOCKS = {
  tiles, table, space, timeline, map, summary,
  charts: all => el('div', {class: 'charts'}, all.map(one => card(chart(one).svg))),
  chart: one => card(chart(one).svg),
  beside: all => el('div', {class: 'two'}, all.map(block)),
  note: text => el('p', {class: 'note'}, marked(text)),
  pre: text => el('div', {class: 'card'}, el('pre', {}, text)),
  command: text => el('div', {class: 'card'}, el('pre', {class: 'wrap'}, text)),
  folded: ({name, block: one}) => el('details', {}, el('summary', {}, name), block(one)),
};
function block(one) { const [kind, value] = Object.entries(one)[0]; return BLOCKS[kind](value); }
function part({heading, about, fold, blocks}) {
  const inner = [paragraph(about), blocks.map(block)], title = heading ? el('h2', {}, heading) : null;
  return fold ? el('details', {class: fold}, el('summary', {}, title), inner) : [title, inner].flat(2);
}
function report({title, under, answer, parts, version}) {
  document.querySelector('main').append(...[
    el('header', {}, el('h1', {}, title), el('p', {}, under)),
    el('div', {class: 'card answer'}, el('p', {class: `pill ${answer.tone || 'plain'}`}, answer.verdict),
      el('b', {}, 'Why'), el('p', {}, marked(answer.why)), el('b', {}, 'Next'), el('p', {}, marked(answer.next))),
    ...parts.flatMap(part),
    el('footer', {}, `Made by cubectl ${version}. Everything is inside this file: it needs no network. Drag across a chart to enlarge a part of it; a double click shows all of it.`),
  ].flat(3).filter(node => node));
  later.forEach(begin => begin());
}
