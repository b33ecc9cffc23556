// A line at the present time in every chart over time; the values there while the pointer is on a chart.
(() => {
  const charts = [...document.querySelectorAll('svg[data-time]')].map(svg => {
    const [x0, x1, left, width, top, height, y0, y1] = svg.dataset.time.split(' ').map(Number);
    const mark = document.createElementNS('http://www.w3.org/2000/svg', 'path'); mark.setAttribute('class', 'now'); svg.append(mark);
    const tip = document.createElementNS('http://www.w3.org/2000/svg', 'text'); tip.setAttribute('class', 'tip'); svg.append(tip);
    // Of each curve: name, times and values of its points. Curves without times have those of the curve before.
    let before = [];
    const curves = [...svg.querySelectorAll('path[data-values]')].map(path => {
      if (path.dataset.ms !== undefined) before = path.dataset.ms.split(' ').map(ms => ms / 1e3);
      return {name: path.dataset.name, times: before, values: path.dataset.values.split(' ')};
    });
    // Number of the point nearest to a time; none for a curve that is not there at this time.
    const nearest = ({times}, t) => {
      let best = 0; for (let i = 1; i < times.length; i++) if (Math.abs(times[i] - t) < Math.abs(times[best] - t)) best = i;
      return Math.abs(times[best] - t) < 0.05 * (x1 - x0) ? best : undefined;
    };
    const show = (t, values) => {
      if (t < x0 || t > x1) { mark.setAttribute('d', ''); tip.textContent = ''; return; }
      const x = left + (t - x0) / (x1 - x0) * width; mark.setAttribute('d', `M${x} ${top}V${top + height}`);
      tip.textContent = '';
      if (!values) return;
      const points = curves.map(curve => nearest(curve, t));
      // The time of the sample nearest to the pointer.
      let at = t, apart = Infinity;
      points.forEach((i, k) => {
        const away = i === undefined ? Infinity : Math.abs(curves[k].times[i] - t);
        if (away < apart) { apart = away; at = curves[k].times[i]; }
      });
      const heading = svg.getAttribute('aria-label');
      const told = curves.map((curve, k) => {
        const value = points[k] === undefined ? '–' : curve.values[points[k]].replace('-', '−');
        // The heading of the chart names its only curve.
        return curve.name === heading ? value : `${curve.name} ${value}`;
      });
      // As many to a line as its width holds; a character is about 6.2 wide.
      const lines = [`${at.toFixed(3).replace('-', '−')} s:`];
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
