// A line at the present time in every chart over time; the values there while the pointer is on a chart.
(() => {
  const charts = [...document.querySelectorAll('svg[data-time]')].map(svg => {
    const [x0, x1, left, width, top, height, y0, y1] = svg.dataset.time.split(' ').map(Number);
    const mark = document.createElementNS('http://www.w3.org/2000/svg', 'path'); mark.setAttribute('class', 'now'); svg.append(mark);
    const tip = document.createElementNS('http://www.w3.org/2000/svg', 'text'); tip.setAttribute('class', 'tip'); svg.append(tip);
    const value = (d, x) => {
      const points = d.slice(1).split(/[ML]/).map(p => p.split(' ').map(Number));
      let best = points[0]; for (const p of points) if (Math.abs(p[0] - x) < Math.abs(best[0] - x)) best = p;
      return y1 - (best[1] - top) / height * (y1 - y0);
    };
    const show = (t, values) => {
      if (t < x0 || t > x1) { mark.setAttribute('d', ''); tip.textContent = ''; return; }
      const x = left + (t - x0) / (x1 - x0) * width; mark.setAttribute('d', `M${x} ${top}V${top + height}`);
      tip.textContent = '';
      if (!values) return;
      const named = [...svg.querySelectorAll('path[data-name]')].map(p => `${p.dataset.name} ${value(p.getAttribute('d'), x).toPrecision(3)}`);
      tip.textContent = `${t.toFixed(3)} s: ${named.slice(0, 7).join(', ')}`;
      tip.setAttribute('x', left + 4); tip.setAttribute('y', top + height - 5);
    };
    svg.addEventListener('pointermove', e => {
      const box = svg.getBoundingClientRect(), x = (e.clientX - box.left) / box.width * svg.viewBox.baseVal.width;
      const t = x0 + (x - left) / width * (x1 - x0); if (t < x0 || t > x1) return;
      charts.forEach(c => c.show(t, c.svg === svg)); dispatchEvent(new CustomEvent('chart-time', {detail: t}));
    });
    svg.addEventListener('pointerleave', () => { tip.textContent = ''; });
    return {svg, show};
  });
  addEventListener('plan-time', e => charts.forEach(c => c.show(e.detail, c.svg.matches(':hover'))));
})();
