// What the bus shows, as it comes: one WebSocket, snapshots fifty times a second, the same drawings as in a report.
(() => {
  const el = id => document.getElementById(id), svgOf = name => document.createElementNS('http://www.w3.org/2000/svg', name);
  const SPAN_S = 10, KEPT = 600, EVENTS = 60;
  const fixed = (value, digits) => value === null || value === undefined ? '–' : value.toFixed(digits).replace('-', '−');
  let last = null, heard = 0, socket = null, dirty = false, told_s = 0, stop_shown = false;

  // A chart over the last seconds, with the classes of the report's charts. On a phone it is drawn smaller, its letters are not.
  const phone = innerWidth < 640, W = phone ? 340 : 600, LEFT = 58, h = phone ? 130 : 156, w = W - LEFT - 14;
  // With `both` the limit holds below zero too.
  function chart(box, title, unit, names, floor, limit, both) {
    // Places of the names; a row that is full is followed by another. A character is about 6.2 wide.
    let right = 0, row = 0;
    const legend = names.map(name => {
      const length = 32 + 6.2 * name.length;
      if (right > 0 && right + length - 12 > W) { right = 0; row += 1; }
      right += length;
      return [right - length, row];
    });
    const TOP = 46 + 15 * row, H = TOP + h + 38;
    const series = names.map(() => []), svg = svgOf('svg');
    svg.setAttribute('viewBox', `0 0 ${W} ${H}`); svg.setAttribute('role', 'img'); svg.setAttribute('aria-label', title);
    el(box).append(svg);
    // Where the pointer is, as a share of the frame.
    let pointer = null;
    svg.addEventListener('pointermove', e => {
      const place = svg.getBoundingClientRect(), x = (e.clientX - place.left) / place.width * W;
      pointer = x >= LEFT && x <= LEFT + w ? (x - LEFT) / w : null; dirty = true;
    });
    svg.addEventListener('pointerleave', () => { pointer = null; dirty = true; });
    const nearest = (points, t) => points.reduce((best, p) => !best || Math.abs(p[0] - t) < Math.abs(best[0] - t) ? p : best, null);
    const tag = (name, attributes, text) => {
      const node = svgOf(name); for (const key in attributes) node.setAttribute(key, attributes[key]);
      if (text !== undefined) node.textContent = text; svg.append(node);
    };
    // The samples nearest to the pointer, with the names of their curves.
    function tell(shown, at, sx) {
      const points = shown.map(one => nearest(one, at)), first = points.find(p => p);
      if (!first) return;
      tag('path', {class: 'now', d: `M${sx(first[0]).toFixed(1)} ${TOP}V${TOP + h}`});
      const told = points.map((p, i) => `${names[i]} ${p ? fixed(p[1], 3) : '–'}`.trim());
      const lines = [`${fixed(first[0], 3)} s:`];
      for (const text of told) {
        if ((lines.at(-1).length + text.length + 2) * 6.2 > w) lines.push(text);
        else lines[lines.length - 1] += (lines.at(-1).endsWith(':') ? ' ' : ', ') + text;
      }
      lines.forEach((text, i) => tag('text', {class: 'tip', x: LEFT + 4, y: TOP + h - 5 - 14 * (lines.length - 1 - i)}, text));
    }
    return {
      add(t, values) {
        values.forEach((value, i) => {
          if (value === null || value === undefined) return;
          // Time that goes back is another session.
          if (series[i].length && series[i].at(-1)[0] > t) series[i].length = 0;
          series[i].push([t, value]); if (series[i].length > KEPT) series[i].shift();
        });
      },
      draw(t) {
        const shown = series.map(points => points.filter(p => p[0] >= t - SPAN_S));
        const all = shown.flat().map(p => p[1]);
        let lo = Math.min(floor[0], ...all), hi = Math.max(floor[1], ...all);
        if (limit && hi > 0.25 * limit) hi = Math.max(hi, limit);
        if (both && lo < -0.25 * limit) lo = Math.min(lo, -limit);
        const pad = 0.06 * (hi - lo); lo -= pad; hi += pad;
        const sx = x => LEFT + (x - t + SPAN_S) / SPAN_S * w, sy = y => TOP + (hi - y) / (hi - lo) * h;
        svg.textContent = '';
        tag('text', {x: 0, y: 14, class: 't'}, title);
        const raw = (hi - lo) / 5, power = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 5, 10].find(d => d * power >= raw) * power;
        const digits = Math.max(0, -Math.floor(Math.log10(step)));
        for (let y = Math.ceil(lo / step) * step; y <= hi + 1e-9; y += step) {
          tag('path', {class: Math.abs(y) < 1e-9 * step ? 'z' : 'g', d: `M${LEFT} ${sy(y).toFixed(1)}H${LEFT + w}`});
          tag('text', {x: LEFT - 6, y: (sy(y) + 4).toFixed(1), 'text-anchor': 'end'}, fixed(Math.abs(y) < 1e-9 * step ? 0 : y, digits));
        }
        for (let s = 0; s <= SPAN_S; s += 2) {
          tag('path', {class: 'g', d: `M${sx(t - s).toFixed(1)} ${TOP}V${TOP + h}`});
          tag('text', {x: sx(t - s).toFixed(1), y: TOP + h + 15, 'text-anchor': 'middle'}, s ? `−${s}` : 'now');
        }
        tag('text', {x: LEFT + w / 2, y: H - 4, 'text-anchor': 'middle'}, 'time in s');
        tag('text', {transform: `translate(12 ${TOP + h / 2}) rotate(-90)`, 'text-anchor': 'middle'}, unit);
        for (const bound of both ? [limit, -limit] : [limit]) {
          if (bound && bound >= lo && bound <= hi) tag('path', {class: 'limit', d: `M${LEFT} ${sy(bound).toFixed(1)}H${LEFT + w}`});
        }
        shown.forEach((points, i) => {
          const d = points.map((p, k) => `${k ? 'L' : 'M'}${sx(p[0]).toFixed(1)} ${sy(p[1]).toFixed(1)}`).join('');
          tag('path', {class: `c s${i % 6}`, d});
          if (!names[i]) return;
          const [x, below] = [legend[i][0], 15 * legend[i][1]];
          tag('path', {class: `c s${i % 6}`, d: `M${x} ${29 + below}h16`}); tag('text', {x: x + 20, y: 33 + below}, names[i]);
        });
        if (pointer !== null) tell(shown, t - SPAN_S + pointer * SPAN_S, sx);
      },
    };
  }
  // A phone shows arm, joints and the stop; the rest is one touch away.
  if (phone) document.querySelectorAll('details').forEach(part => { part.open = false; });
  const names = live.joints;
  const charts = [
    chart('errors', `Position errors, as the controller reports them; bound ±${live.bound_mrad} mrad`, 'error in mrad', names, [-1, 1],
      live.bound_mrad, true),
    chart('currents', 'Motor currents', 'current in A', names, [-0.5, 0.5]),
    chart('angles', 'Angles', 'angle in rad', names, [-0.1, 0.1]),
    chart('load', 'Bus load, without stuff bits', 'share in %', [''], [0, 10], 100),
  ];

  const cell = (row, i) => { while (row.cells.length <= i) row.insertCell(); return row.cells[i]; };
  function put(row, values, left) {
    values.forEach((value, i) => { const c = cell(row, i); if (c.textContent !== value) c.textContent = value; if (left.includes(i)) c.className = 'l'; });
  }
  function tile(id, text, tone) { const b = el(id); if (b.textContent !== text) b.textContent = text; b.className = `${tone || ''} ${text.length > 10 ? 'long' : ''}`; }

  function take(now) {
    last = now; heard = performance.now(); dirty = true;
    el('ended').hidden = !now.ended;
    if (now.ended && !el('ended').textContent) {
      el('ended').textContent = now.ended.text + (now.ended.report ? '. ' : '');
      if (now.ended.report) { const link = document.createElement('a'); link.href = '/report'; link.textContent = 'Report'; el('ended').append(link); }
    }
    if (!now.ended) el('ended').textContent = '';
    const c = now.controller;
    charts[0].add(now.t_s, now.joints.map(j => j.error_rad === null ? null : 1e3 * j.error_rad));
    charts[1].add(now.t_s, now.joints.map(j => j.current_a));
    charts[2].add(now.t_s, now.joints.map(j => j.q_rad));
    charts[3].add(now.t_s, [now.load_percent]);
    for (const event of now.events) {
      const row = el('events').insertRow(1);
      put(row, [fixed(event.t_s, 3), event.source, event.text], [0, 1, 2]);
      row.cells[2].className = 'l ' + ({warning: 'warn', error: 'bad'}[event.severity] || '');
      // The oldest goes that stopped nothing.
      const rows = [...el('events').rows].slice(1), least = rows.findLast(row => row.cells[2].className === 'l ');
      if (rows.length > EVENTS) (least || rows.at(-1)).remove();
    }
    const trail = scene.hand;
    if (now.placed) {
      trail.push(now.placed.hand_m); if (trail.length > 400) trail.shift();
      dispatchEvent(new CustomEvent('live-step', {detail: {t: now.t_s, ball: c && c.gripper_open ? null : now.placed.hand_m, links: now.placed.links}}));
    }
    // What the bus says of a stop, until it is over; before that what was ordered here.
    if (now.stop || stop_shown) el('stopped').textContent = now.stop ? now.stop.text : '';
    stop_shown = Boolean(now.stop);
    el('fault').hidden = !(c && c.fault);
    if (c && c.fault) el('fault').textContent = `fault ${c.fault.code}${c.fault.joint ? `, joint ${c.fault.joint}` : ''}: ${c.fault.what}. What to do: ${c.fault.next}.${c.old ? ` (The controller is ${c.state}.)` : ''}`;
  }

  // What the program says of age goes for the page, too: what it has not sent again for so long is old.
  function draw() {
    // What has ended stays as it was: the last picture is no old one.
    const over = last && last.ended;
    const gap_s = (performance.now() - heard) / 1e3, silent = !over && (!last || gap_s > live.old_after_s || !socket || socket.readyState !== WebSocket.OPEN);
    const link = el('ended').querySelector('a');
    if (link && gap_s > live.old_after_s) link.remove();
    el('link').textContent = over ? 'ended' : silent ? (last ? 'not connected: what is shown is old' : 'connecting') : last.link.text;
    el('link').className = 'pill ' + (over ? 'plain' : silent ? 'warn' : last.link.tone);
    // Who stood once is not known to stand.
    const tone = last && last.stop ? last.stop.tone : '';
    el('stopped').className = tone === 'good' && (silent || over || last.link.tone !== 'good') ? 'warn' : tone;
    // While nothing comes, the ages still grow.
    if (last && (dirty || silent && Math.round(gap_s) !== told_s)) {
      dirty = false; told_s = Math.round(gap_s);
      const c = last.controller, gone = silent ? `not heard for ${told_s} s` : '', aged = silent || c && c.old ? 'warn' : '';
      tile('state', c ? gone || c.state : 'no controller is heard', c ? (silent ? 'bad' : over ? '' : c.tone) : '');
      tile('plan', c && c.plan_s > 0 ? `${fixed(c.plan_s, 2)} s` : '–', aged);
      tile('counts', c ? `${c.cycles_saturated} / ${c.cycles_late} / ${c.replies_missed}` : '–', aged);
      tile('period', c && c.period_us ? `${fixed(c.period_us / 1e3, 0)} ms` : '–', aged);
      tile('busload', `${fixed(last.load_percent, 1)} %`, silent || last.load_percent > 90 ? 'warn' : '');
      tile('errorcount', String(last.bus_errors), silent || last.bus_errors ? 'warn' : '');
      tile('gripper', c ? (c.gripper_open ? 'open' : 'closed') : '–', aged);
      tile('session', `${fixed(last.t_s, 2)} s`, silent ? 'warn' : '');
      last.joints.forEach((j, i) => {
        const row = el('joints').rows[i + 1] || el('joints').insertRow(-1), age_s = j.age_s === null ? null : j.age_s + (silent ? gap_s : 0);
        const [qd, error, current] = silent ? [null, null, null] : [j.qd_rad_s, j.error_rad, j.current_a];
        put(row, [j.name, fixed(j.q_rad, 4), fixed(qd, 3), fixed(error === null ? null : 1e3 * error, 2), fixed(current, 2), fixed(age_s === null ? null : 1e3 * age_s, 0), j.q_rad === null ? j.state || '–' : gone || j.state || '–'], [0, 6]);
        row.cells[3].className = Math.abs(1e3 * error) > live.bound_mrad ? 'bad' : '';
        row.classList.toggle('old', j.old || silent && j.q_rad !== null);
        row.dataset.tS = last.t_s;
      });
      charts.forEach(one => one.draw(last.t_s));
    }
    requestAnimationFrame(draw);
  }

  function connect() {
    socket = new WebSocket(`ws://${location.host}/live`);
    socket.onmessage = message => take(JSON.parse(message.data));
    // The program may come back: the page waits for it.
    socket.onclose = () => setTimeout(connect, 500);
  }
  function stop() {
    // The program has left the bus: it cannot stop anything any more.
    if (last && last.ended) { el('stopped').textContent = 'this program has left the bus: use the contactor'; return; }
    if (socket && socket.readyState === WebSocket.OPEN) socket.send('stop');
    // By both ways: a socket may hang.
    fetch('/stop', {method: 'POST'}).then(answer => { if (!stop_shown) el('stopped').textContent = answer.ok ? 'stop ordered' : 'the stop was refused'; })
      .catch(() => { el('stopped').textContent = 'the program is not reached: use the contactor'; });
  }
  el('stop').onclick = stop;
  addEventListener('keydown', event => { if (event.key === 'Escape') stop(); });
  connect(); draw();
})();
