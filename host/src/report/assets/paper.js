// Paper shows the parts that belong on it, folded or not, in light colours. It takes at most four sheets, filled alike: a page becomes
// smaller where that saves a sheet, and sheets begin where least of each is left empty.
(() => {
  const main = document.querySelector('main'), [dark, narrow, paper] = ['dark', 'narrow', 'paper'].map(id => document.getElementById(id));
  // A4 less its margins; the browser may set a page a little higher than it is computed here.
  const WIDTH_MM = 192, HEIGHT_MM = 279 - 6, SHEETS_MAX = 4, ZOOM_SMALL = 0.86, ZOOM_MIN = 0.5, ZOOM_STEP = 0.02;
  let opened = [], begins = [];
  function lay(isPaper, zoom) {
    opened.forEach(part => { part.open = isPaper; });
    dark.disabled = narrow.disabled = isPaper;
    [paper.media, main.style.width] = isPaper ? ['all', `${WIDTH_MM}mm`] : ['print', ''];
    main.style.zoom = zoom;
    begins.forEach(part => { part.style.breakBefore = isPaper ? 'page' : ''; });
    dispatchEvent(new Event('resize'));
  }
  // What is not divided, with its top and bottom in mm; a heading stays with what is below it, and so does what stands beside.
  function blocks() {
    const found = []; let heading;
    for (const part of main.querySelectorAll('header,h2,p,tr,footer,.tile,.card:not(:has(tr:nth-child(13)))')) {
      const {top, bottom, height} = part.getBoundingClientRect(), last = found.at(-1);
      if (!height) continue;
      heading ??= {part: part.closest('summary,thead')?.parentElement ?? part, top};
      if (part.matches('h2,h2+p,summary+p,thead tr')) continue;
      if (last && heading.top < last.bottom) last.bottom = Math.max(last.bottom, bottom);
      else found.push({...heading, bottom});
      heading = undefined;
    }
    return found;
  }
  // Where sheets begin so that the squares of what is left empty are least; one that begins without a heading counts as a tenth emptier.
  function divide(blocks, high) {
    const best = [{cost: 0}];
    for (let end = 1; end <= blocks.length; end++) for (let from = end - 1; from >= 0; from--) {
      const left = high - (blocks[end - 1].bottom - blocks[from].top), inside = blocks[from].part.matches('header,h2,details') ? 0 : high / 10;
      const cost = best[from].cost + left * left + inside * inside;
      if (left < 0 && from < end - 1) break;
      if (!best[end] || cost < best[end].cost) best[end] = {cost, from};
    }
    const found = []; for (let end = blocks.length; end; end = best[end].from) found.unshift(blocks[best[end].from].part);
    return found;
  }
  addEventListener('beforeprint', () => {
    opened = [...document.querySelectorAll('details.part:not([open])')];
    lay(true, 1);
    const all = blocks(), of = zoom => divide(all, HEIGHT_MM * 96 / 25.4 / zoom), most = Math.min(SHEETS_MAX, of(ZOOM_SMALL).length);
    let zoom = 1; while (of(zoom).length > most && zoom > ZOOM_MIN) zoom -= ZOOM_STEP;
    begins = of(zoom).slice(1);
    lay(true, zoom);
  });
  addEventListener('afterprint', () => { lay(false, ''); begins = []; });
})();
