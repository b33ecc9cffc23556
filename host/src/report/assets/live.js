// What the bus shows, as it comes: one WebSocket, snapshots fifty times a second, the same drawings as in a report.
(() => {
  const by = id => document.getElementById(id);
  const SPAN_S = 10, KEPT = 600, EVENTS = 60;
  const fixed = (value, digits) => value === null || value === undefined ? '–' : value.toFixed(digits).replace('-', '−');
  let last = null, heard = 0, socket = null, dirty = false, reported_s = 0, stop_shown = false;

  // A chart over the last seconds. On a phone it is drawn smaller, its letters are not.
  const phone = innerWidth < 640;
  // With `both` the limit holds below zero too.
  function recent(title, unit, names, floor, limit, both) {
    const bounds = limit ? both ? [limit, -limit] : [limit] : [];
    const one = chart({title, x_label: 'time in s', y_label: unit, y_at_least: floor, time: true, origin: 0, span: [-SPAN_S, 0],
      curves: [...names.map((name, i) => ({name, colour: i % 6, pen: 'line', points: []})), ...bounds.map(() => ({pen: 'limit', points: []}))],
    }, phone ? 340 : 600, phone ? 130 : 156);
    const series = one.data.curves.slice(0, names.length);
    return {
      svg: one.svg,
      add(t, values) {
        values.forEach((value, i) => {
          if (value === null || value === undefined) return;
          const {points} = series[i];
          // Time that goes back is another session.
          if (points.length && points.at(-1)[0] > t) points.length = 0;
          points.push([t, value]); if (points.length > KEPT) points.shift();
        });
      },
      draw(t) {
        one.data.origin = t; one.data.span = [t - SPAN_S, t];
        const shown = series.flatMap(({points}) => points.filter(p => p[0] >= t - SPAN_S).map(p => p[1]));
        // A limit that is far away is not drawn.
        bounds.forEach((bound, i) => {
          const isNear = shown.some(value => value / bound > 0.25);
          one.data.curves[names.length + i].points = isNear ? [[t - SPAN_S, bound], [t, bound]] : [];
        });
        one.draw();
      },
    };
  }
  const tile = (id, what) => ({value: '–', unit: '', what, tone: '', id}), headed = (id, ...names) => el('table', {id}, el('tbody', {}, el('tr', {}, names.map(name =>
    el('th', {class: name.startsWith('<') ? 'l' : ''}, name.replace('<', ''))))));
  const open = (title, about, inner) => el('details', {open: 'open'}, el('summary', {}, el('h2', {}, title)), el('p', {}, about), inner);
  const names = data.joints, scene = window.scene = data.scene;
  const charts = [
    recent(`Position errors, as the controller reports them; bound ±${data.bound_mrad} mrad`, 'error in mrad', names, [-1, 1], data.bound_mrad, true),
    recent('Motor currents', 'current in A', names, [-0.5, 0.5]),
    recent('Angles', 'angle in rad', names, [-0.1, 0.1]),
    recent('Bus load, without stuff bits', 'share in %', [''], [0, 10], 100),
  ];
  document.querySelector('main').append(
    el('header', {}, el('h1', {}, data.title, el('span', {class: 'pill warn', id: 'link'}, 'connecting')),
      el('p', {}, 'What passes on the bus, fifty times a second. This page looks and stops; it moves nothing.')),
    el('div', {class: 'stopbar'}, el('button', {id: 'stop'}, 'Stop (Esc)'), el('output', {id: 'stopped'})),
    el('p', {class: 'card', id: 'ended', hidden: 'hidden'}), el('p', {class: 'card bad', id: 'fault', hidden: 'hidden'}),
    tiles([tile('state', 'state of the group'), tile('plan', 'time of the plan'), tile('counts', 'saturated, late cycles, missed answers'),
      tile('period', 'control period'), tile('busload', 'load of the bus'), tile('errorcount', 'errors of the bus'),
      tile('gripper', 'gripper'), tile('session', 'since the session began')]),
    el('div', {class: 'scene'}, el('figure', {class: 'card'}, el('canvas', {id: 'scene', 'aria-label': 'arm'}), el('div', {class: 'bar'}, VIEWS()),
      scene.flight.length ? el('figcaption', {}, 'Dots: the flight as planned.') : ''),
      el('div', {class: 'card scroll'}, headed('joints', '<joint', 'q rad', 'speed rad/s', 'error mrad', 'current A', 'age ms', '<drive'))),
    open('Charts', 'The last ten seconds.', el('div', {class: 'two'},
      ['errors', 'currents', 'angles', 'load'].map((id, i) => el('figure', {class: 'card', id}, charts[i].svg)))),
    open('Events', 'What controller, host and drives said; the newest first.',
      el('div', {class: 'card recent'}, headed('events', '<time s', '<who', '<what'))),
    el('footer', {}, `Served by cubectl ${data.version} to this machine only.`));
  inSpace(scene);
  // A phone shows arm, joints and the stop; the rest is one touch away.
  if (phone) document.querySelectorAll('details').forEach(part => { part.open = false; });
  const cell = (row, i) => { while (row.cells.length <= i) row.insertCell(); return row.cells[i]; };
  function put(row, values, left) {
    values.forEach((value, i) => { const c = cell(row, i); if (c.textContent !== value) c.textContent = value; if (left.includes(i)) c.className = 'l'; });
  }
  function set(id, text, tone) { const b = by(id); if (b.textContent !== text) b.textContent = text; b.className = `${tone || ''} ${text.length > 10 ? 'long' : ''}`; }

  function take(now) {
    last = now; heard = performance.now(); dirty = true;
    by('ended').hidden = !now.ended;
    if (now.ended && !by('ended').textContent) {
      by('ended').textContent = now.ended.text + (now.ended.report ? '. ' : '');
      if (now.ended.report) { const link = document.createElement('a'); link.href = '/report'; link.textContent = 'Report'; by('ended').append(link); }
    }
    if (!now.ended) by('ended').textContent = '';
    const c = now.controller;
    charts[0].add(now.t_s, now.joints.map(j => j.error_rad === null ? null : 1e3 * j.error_rad));
    charts[1].add(now.t_s, now.joints.map(j => j.current_a));
    charts[2].add(now.t_s, now.joints.map(j => j.q_rad));
    charts[3].add(now.t_s, [now.load_percent]);
    for (const event of now.events) {
      const row = by('events').insertRow(1);
      put(row, [fixed(event.t_s, 3), event.source, event.text], [0, 1, 2]);
      row.cells[2].className = 'l ' + ({warning: 'warn', error: 'bad'}[event.severity] || '');
      // The oldest goes that stopped nothing.
      const rows = [...by('events').rows].slice(1), least = rows.findLast(row => row.cells[2].className === 'l ');
      if (rows.length > EVENTS) (least || rows.at(-1)).remove();
    }
    const trail = scene.hand;
    if (now.placed) {
      trail.push(now.placed.hand_m); if (trail.length > 400) trail.shift();
      dispatchEvent(new CustomEvent('live-step', {detail: {t: now.t_s, ball: c && c.gripper_open ? null : now.placed.hand_m, links: now.placed.links}}));
    }
    // What the bus says of a stop, until it is over; before that what was ordered here.
    if (now.stop || stop_shown) by('stopped').textContent = now.stop ? now.stop.text : '';
    stop_shown = Boolean(now.stop);
    by('fault').hidden = !(c && c.fault);
    if (c && c.fault) by('fault').textContent = `fault ${c.fault.code}${c.fault.joint ? `, joint ${c.fault.joint}` : ''}: ${c.fault.what}. What to do: ${c.fault.next}.${c.old ? ` (The controller is ${c.state}.)` : ''}`;
  }

  // What the program says of age goes for the page, too: what it has not sent again for so long is old.
  function draw() {
    // What has ended stays as it was: the last picture is no old one.
    const over = last && last.ended;
    const gap_s = (performance.now() - heard) / 1e3, silent = !over && (!last || gap_s > data.old_after_s || !socket || socket.readyState !== WebSocket.OPEN);
    const link = by('ended').querySelector('a');
    if (link && gap_s > data.old_after_s) link.remove();
    by('link').textContent = over ? 'ended' : silent ? (last ? 'not connected: what is shown is old' : 'connecting') : last.link.text;
    by('link').className = 'pill ' + (over ? 'plain' : silent ? 'warn' : last.link.tone);
    // Who stood once is not known to stand.
    const tone = last && last.stop ? last.stop.tone : '';
    by('stopped').className = tone === 'good' && (silent || over || last.link.tone !== 'good') ? 'warn' : tone;
    // While nothing comes, the ages still grow.
    if (last && (dirty || silent && Math.round(gap_s) !== reported_s)) {
      dirty = false; reported_s = Math.round(gap_s);
      const c = last.controller, gone = silent ? `not heard for ${reported_s} s` : '', aged = silent || c && c.old ? 'warn' : '';
      set('state', c ? gone || c.state : 'no controller is heard', c ? (silent ? 'bad' : over ? '' : c.tone) : '');
      set('plan', c && c.plan_s > 0 ? `${fixed(c.plan_s, 2)} s` : '–', aged);
      set('counts', c ? `${c.cycles_saturated} / ${c.cycles_late} / ${c.replies_missed}` : '–', aged);
      set('period', c && c.period_us ? `${fixed(c.period_us / 1e3, 0)} ms` : '–', aged);
      set('busload', `${fixed(last.load_percent, 1)} %`, silent || last.load_percent > 90 ? 'warn' : '');
      set('errorcount', String(last.bus_errors), silent || last.bus_errors ? 'warn' : '');
      set('gripper', c ? (c.gripper_open ? 'open' : 'closed') : '–', aged);
      set('session', `${fixed(last.t_s, 2)} s`, silent ? 'warn' : '');
      last.joints.forEach((j, i) => {
        const row = by('joints').rows[i + 1] || by('joints').insertRow(-1), age_s = j.age_s === null ? null : j.age_s + (silent ? gap_s : 0);
        const [qd, error, current] = silent ? [null, null, null] : [j.qd_rad_s, j.error_rad, j.current_a];
        put(row, [j.name, fixed(j.q_rad, 4), fixed(qd, 3), fixed(error === null ? null : 1e3 * error, 2), fixed(current, 2), fixed(age_s === null ? null : 1e3 * age_s, 0), j.q_rad === null ? j.state || '–' : gone || j.state || '–'], [0, 6]);
        row.cells[3].className = Math.abs(1e3 * error) > data.bound_mrad ? 'bad' : '';
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
    if (last && last.ended) { by('stopped').textContent = 'this program has left the bus: use the contactor'; return; }
    if (socket && socket.readyState === WebSocket.OPEN) socket.send('stop');
    // By both ways: a socket may hang.
    fetch('/stop', {method: 'POST'}).then(answer => { if (!stop_shown) by('stopped').textContent = answer.ok ? 'stop ordered' : 'the stop was refused'; })
      .catch(() => { by('stopped').textContent = 'the program is not reached: use the contactor'; });
  }
  by('stop').onclick = stop;
  addEventListener('keydown', event => { if (event.key === 'Escape') stop(); });
  connect(); draw();
})();
