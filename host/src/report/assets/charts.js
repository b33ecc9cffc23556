// A line at the present time in every chart over time; the values there while the pointer is on a chart.
(() => {
  const charts = [...document.querySelectorAll('svg[data-time]')].map(svg => {
    const [x0, x1, left, width, top, height, y0, y1] = svg.dataset.time.split(' ').map(Number);
    const mark = document.createElementNS('http://www.w3.org/2000/svg', 'path'); mark.setAttribute('class', 'now'); svg.append(mark);
    const tip = document.createElementNS('http://www.w3.org/2000/svg', 'text'); tip.setAttribute('class', 'tip'); svg.append(tip);
    // Of each curve: name, where its points are, what their values are.
    const curves = [...svg.querySelectorAll('path[data-values]')].map(path => ({
      name: path.dataset.name, values: path.dataset.values.split(' '),
      xs: path.getAttribute('d').slice(1).split(/[ML]/).map(point => parseFloat(point)),
    }));
    const value = ({xs, values}, x) => {
      let best = 0; for (let i = 1; i < xs.length; i++) if (Math.abs(xs[i] - x) < Math.abs(xs[best] - x)) best = i;
      // A curve that is not there at this time has no value.
      return Math.abs(xs[best] - x) < 0.05 * width ? values[best] : '–';
    };
    const show = (t, values) => {
      if (t < x0 || t > x1) { mark.setAttribute('d', ''); tip.textContent = ''; return; }
      const x = left + (t - x0) / (x1 - x0) * width; mark.setAttribute('d', `M${x} ${top}V${top + height}`);
      tip.textContent = '';
      if (!values) return;
      const told = curves.length === 1 ? [value(curves[0], x)] : curves.map(curve => `${curve.name} ${value(curve, x)}`);
      // As many to a line as its width holds; a character is about 6.2 wide.
      const lines = [`${t.toFixed(3)} s:`];
      for (const text of told) {
        if ((lines.at(-1).length + text.length + 2) * 6.2 > width) lines.push(text);
        else lines[lines.length - 1] += (lines.at(-1).endsWith(':') ? ' ' : ', ') + text;
      }
      lines.forEach((text, i) => {
        const line = document.createElementNS('http://www.w3.org/2000/svg', 'tspan');
        line.textContent = text; line.setAttribute('x', left + 4); line.setAttribute('y', top + height - 5 - 14 * (lines.length - 1 - i));
        tip.append(line);
      });
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
