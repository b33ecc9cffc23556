// The arm, its hand path and the ball's flight in space, drawn on a plain canvas; one time for all pictures of the page.
function inSpace(scene) {
  const canvas = document.getElementById('scene'), ctx = canvas.getContext('2d');
  const slider = document.getElementById('time'), shown = document.getElementById('shown'), play = document.getElementById('play');
  const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const t0 = scene.steps[0].t, t1 = scene.steps[scene.steps.length - 1].t;
  const home = {az: scene.target ? Math.atan2(scene.target[1], scene.target[0]) - 1.05 : 0.6, el: 0.3, zoom: 1};
  let view = {...home}, now = t0, drag = null, running = null;

  const extent = scene.hand.concat(scene.flight, scene.target ? [scene.target] : [], scene.bounds || [], ...[-0.25, 0.25].flatMap(x => [-0.25, 0.25].map(y => [[x, y, scene.floor], [x / 3, y / 3, scene.top]])));
  const lo = [0, 1, 2].map(i => Math.min(...extent.map(p => p[i]))), hi = [0, 1, 2].map(i => Math.max(...extent.map(p => p[i])));
  const middle = lo.map((v, i) => (v + hi[i]) / 2), size = Math.hypot(...hi.map((v, i) => v - lo[i]));

  // World to screen: u right, v up, depth towards the viewer.
  let width = 0, height = 0, scale = 1, shift = [0, 0];
  function turn(p) {
    const x = p[0] - middle[0], y = p[1] - middle[1], z = p[2] - middle[2];
    const ca = Math.cos(view.az), sa = Math.sin(view.az), ce = Math.cos(view.el), se = Math.sin(view.el);
    const u = -sa * x + ca * y, towards = ca * x + sa * y;
    return [u, z * ce - towards * se, towards * ce + z * se];
  }
  function project(p) {
    const [u, v, depth] = turn(p), near = 3.2 * size, k = view.zoom * scale * near / (near - depth);
    return [width / 2 + k * u - view.zoom * shift[0], height / 2 - k * v - view.zoom * shift[1], depth, k];
  }
  // Everything that matters fits, with room for labels, as it is seen now but for the zoom.
  function fit() {
    const zoom = view.zoom; view.zoom = 1; scale = 1; shift = [0, 0];
    const q = extent.map(project), x = q.map(p => p[0]), y = q.map(p => p[1]);
    const w = Math.max(...x) - Math.min(...x), h = Math.max(...y) - Math.min(...y);
    scale = Math.min((width - Math.min(150, 0.3 * width)) / w, (height - Math.min(70, 0.2 * height)) / h);
    shift = [scale * ((Math.max(...x) + Math.min(...x)) / 2 - width / 2), scale * ((Math.max(...y) + Math.min(...y)) / 2 - height / 2)];
    view.zoom = zoom;
  }
  function line(points, colour, w, dash, alpha) {
    ctx.strokeStyle = colour; ctx.lineWidth = w; ctx.globalAlpha = alpha ?? 1; ctx.setLineDash(dash || []); ctx.beginPath();
    points.forEach((p, i) => { const q = project(p); i ? ctx.lineTo(q[0], q[1]) : ctx.moveTo(q[0], q[1]); });
    ctx.stroke(); ctx.setLineDash([]); ctx.globalAlpha = 1;
  }
  function area(points, colour, alpha) {
    ctx.fillStyle = colour; ctx.globalAlpha = alpha; ctx.beginPath();
    points.forEach((p, i) => { const q = project(p); i ? ctx.lineTo(q[0], q[1]) : ctx.moveTo(q[0], q[1]); });
    ctx.closePath(); ctx.fill(); ctx.globalAlpha = 1;
  }
  function label(p, text, dx, dy) {
    const q = project(p); ctx.font = '12px system-ui, sans-serif'; ctx.lineWidth = 3;
    ctx.strokeStyle = css('--card'); ctx.strokeText(text, q[0] + dx, q[1] + dy);
    ctx.fillStyle = css('--ink'); ctx.fillText(text, q[0] + dx, q[1] + dy);
  }
  const ring = (c, r, z) => Array.from({length: 40}, (_, i) => [c[0] + r * Math.cos(i * Math.PI / 20), c[1] + r * Math.sin(i * Math.PI / 20), z]);

  // Between two steps everything is straight: they are close.
  function at(t) {
    let i = scene.steps.findIndex(s => s.t >= t); if (i < 0) i = scene.steps.length - 1;
    if (i === 0) return scene.steps[0];
    const a = scene.steps[i - 1], b = scene.steps[i], k = (t - a.t) / (b.t - a.t || 1), mix = (x, y) => x.map((v, n) => v + k * (y[n] - v));
    return {t, ball: a.ball && mix(a.ball, b.ball), normal: a.normal && mix(a.normal, b.normal), links: a.links.map((l, n) => mix(l, b.links[n]))};
  }
  const faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
  function shade(hex, light) {
    const n = parseInt(hex.slice(1), 16), mix = v => Math.round(Math.max(0, Math.min(255, v * light)));
    return `rgb(${mix(n >> 16)},${mix(n >> 8 & 255)},${mix(n & 255)})`;
  }
  function arm(step) {
    const all = [], body = css('--body'), hand = css('--c5');
    for (const box of scene.boxes) {
      const m = box.link === 0 ? null : step.links[box.link - 1];
      const world = box.corners.map(c => m ? [m[0] * c[0] + m[1] * c[1] + m[2] * c[2] + m[9], m[3] * c[0] + m[4] * c[1] + m[5] * c[2] + m[10], m[6] * c[0] + m[7] * c[1] + m[8] * c[2] + m[11]] : c);
      for (const f of faces) {
        const p = f.map(i => world[i]), q = p.map(turn);
        const e1 = q[1].map((v, i) => v - q[0][i]), e2 = q[2].map((v, i) => v - q[0][i]);
        const n = [e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]];
        const length = Math.hypot(...n) || 1, middleOf = q.reduce((s, c) => s + c[2], 0) / 4;
        const facing = Math.abs(n[2]) / length, up = Math.abs(n[1]) / length;
        all.push({p, depth: middleOf, colour: shade(box.link === 0 ? css('--base') : box.link === scene.last ? hand : body, 0.62 + 0.34 * facing + 0.16 * up)});
      }
    }
    if (step.ball) all.push({ball: step.ball, depth: turn(step.ball)[2] + scene.radius});
    all.sort((a, b) => a.depth - b.depth);
    for (const f of all) {
      if (f.ball && step.normal) { disc(f.ball, step.normal); continue; }
      if (f.ball) {
        const s = project(f.ball), r = Math.max(3.5, s[3] * scene.radius), fill = ctx.createRadialGradient(s[0] - r / 3, s[1] - r / 3, r / 6, s[0], s[1], r);
        fill.addColorStop(0, '#fff'); fill.addColorStop(0.35, css('--fly')); fill.addColorStop(1, css('--fly'));
        ctx.fillStyle = fill; ctx.beginPath(); ctx.arc(s[0], s[1], r, 0, 7); ctx.fill();
        continue;
      }
      ctx.beginPath(); f.p.forEach((p, i) => { const s = project(p); i ? ctx.lineTo(s[0], s[1]) : ctx.moveTo(s[0], s[1]); });
      ctx.closePath(); ctx.fillStyle = f.colour; ctx.fill(); ctx.strokeStyle = f.colour; ctx.lineWidth = 0.6; ctx.stroke();
    }
  }
  function disc(c, n) {
    const side = Math.abs(n[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const e1 = cross(n, side), l = Math.hypot(...e1), u = e1.map(v => v / l), w = cross(n, u);
    const rim = Array.from({length: 40}, (_, i) => c.map((v, k) => v + scene.radius * (u[k] * Math.cos(i * Math.PI / 20) + w[k] * Math.sin(i * Math.PI / 20))));
    area(rim, css('--fly'), 0.8); line(rim.concat([rim[0]]), css('--ink'), 0.8);
  }
  function goal(p) {
    const tz = p[2];
    if (scene.rim) line(scene.rim.concat([scene.rim[0]]), css('--ink'), 2);
    else line(ring(p, 0.06, tz).concat([[p[0] + 0.06, p[1], tz]]), css('--ink'), 1.5);
    line([[p[0] - 0.09, p[1], tz], [p[0] + 0.09, p[1], tz]], css('--ink'), 1.5);
    line([[p[0], p[1] - 0.09, tz], [p[0], p[1] + 0.09, tz]], css('--ink'), 1.5);
  }
  function draw() {
    const ratio = Math.max(2, devicePixelRatio); width = canvas.clientWidth; height = canvas.clientHeight;
    canvas.width = width * ratio; canvas.height = height * ratio; ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, width, height); fit();
    const z = scene.floor, a = Math.floor(Math.min(lo[0], lo[1], -0.6) * 2) / 2, b = Math.ceil(Math.max(hi[0], hi[1], 0.6) * 2) / 2;
    area([[a, a, z], [b, a, z], [b, b, z], [a, b, z]], css('--floor'), 0.45);
    for (let i = a; i <= b + 1e-9; i += 0.5) { line([[i, a, z], [i, b, z]], css('--line'), 1); line([[a, i, z], [b, i, z]], css('--line'), 1); }
    for (const [d, name, colour] of [[[0.3, 0, 0], 'x', '--c1'], [[0, 0.3, 0], 'y', '--c2'], [[0, 0, 0.3], 'z', '--c0']]) {
      const tip = [d[0], d[1], z + 0.002 + d[2]]; line([[0, 0, z + 0.002], tip], css(colour), 2); label(tip, name, 4, 4);
    }
    const step = at(now);
    if (scene.ellipse) { area(scene.ellipse, css('--c2'), 0.3); line(scene.ellipse.concat([scene.ellipse[0]]), css('--c2'), 1.5); }
    if (scene.target) goal(scene.target);
    if (step.ball) area(ring(step.ball, scene.radius * 1.1, z + 0.001), '#000', 0.25);
    if (scene.planned) line(scene.planned, css('--soft'), 1.2, [4, 4]);
    line(scene.hand, css('--path'), 1.6, [5, 3]);
    if (scene.flight.length) line(scene.flight, css('--fly'), 1.2, [2, 4]);
    const flown = scene.release === null ? [] : scene.steps.filter(s => s.t >= scene.release && s.t <= now).map(s => s.ball);
    if (flown.length) line(flown.concat([step.ball]), css('--fly'), 2.4);
    arm(step);
    const [there, first] = scene.names || ['target', 'release'];
    if (scene.target) label(scene.target, there, 12, -8);
    if (scene.flight.length) label(scene.flight[0], first, -52, 4);
    if (slider) { shown.textContent = `t = ${now.toFixed(3)} s`; slider.value = Math.round(1000 * (now - t0) / (t1 - t0)); }
    window.dispatchEvent(new CustomEvent('plan-time', {detail: now}));
  }
  function stop() { cancelAnimationFrame(running); running = null; play.textContent = 'Play'; }
  function start() {
    if (now >= t1 - 1e-6) now = t0;
    play.textContent = 'Pause'; let last = performance.now();
    const speed = +document.getElementById('speed').value;
    const tick = stamp => { now = Math.min(t1, now + Math.max(0, stamp - last) / 1000 * speed); last = stamp; draw(); now < t1 ? running = requestAnimationFrame(tick) : stop(); };
    running = requestAnimationFrame(tick);
  }
  if (slider) {
    play.onclick = () => running ? stop() : start();
    slider.oninput = () => { stop(); now = t0 + (t1 - t0) * slider.value / 1000; draw(); };
  }
  // A live page has no time of a plan: it shows the step that came last.
  addEventListener('live-step', e => { scene.steps = [e.detail]; now = e.detail.t; draw(); });
  document.getElementById('reset').onclick = () => { view = {...home}; draw(); };
  document.getElementById('top').onclick = () => { view = {az: -Math.PI / 2, el: Math.PI / 2 - 0.001, zoom: 1}; draw(); };
  canvas.onpointerdown = e => { drag = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); };
  canvas.onpointermove = e => { if (!drag) return; view.az -= (e.clientX - drag[0]) * 0.008; view.el = Math.max(-1.5, Math.min(1.57, view.el + (e.clientY - drag[1]) * 0.008)); drag = [e.clientX, e.clientY]; draw(); };
  canvas.onpointerup = () => drag = null;
  canvas.onwheel = e => { e.preventDefault(); view.zoom *= Math.exp(-e.deltaY * 0.001); draw(); };
  addEventListener('resize', draw); matchMedia('(prefers-color-scheme: dark)').addEventListener('change', draw);
  addEventListener('chart-time', e => { if (!running && e.detail >= t0 && e.detail <= t1) { now = e.detail; draw(); } });
  now = scene.first ?? (scene.release === null ? t1 : Math.min(t1, scene.release + 0.35 * (t1 - scene.release))); draw();
}
