// Drawing: elements, axes with lines, dots and bands, and maps.

const SVG = 'http://www.w3.org/2000/svg';

/** An element with attributes and children; names of SVG elements begin with `svg:`. */
function h(name, attributes = {}, ...children) {
  const element = name.startsWith('svg:') ? document.createElementNS(SVG, name.slice(4)) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith('on')) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, '');
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** A number as text, with a minus sign. */
function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return '-';
  if (value === 0) return '0';
  const text = Math.abs(value) >= 1e4 || Math.abs(value) < 1e-3 ? value.toExponential(digits - 1) : Number(value.toPrecision(digits)).toString();
  return text.replace('-', '\u2212');
}

/** A difference: its sign is shown where it is positive, too. */
const signed = (value) => `${value > 0 ? '+' : ''}${number(value)}`;

const interval = ([low, high], digits = 3) => `${number(low, digits)} to ${number(high, digits)}`;

/** From the least to the greatest value with a margin. */
function rangeOf(lists, share = 0.06) {
  let [least, most] = [Infinity, -Infinity];
  lists.forEach((list) => list.forEach((value) => {
    if (Number.isFinite(value)) { least = Math.min(least, value); most = Math.max(most, value); }
  }));
  if (least > most) return [0, 1];
  const margin = share * (most - least) || Math.max(Math.abs(most) * share, 1e-3);
  return [least - margin, most + margin];
}

/** About `count` round values in a range; if possible at least three, so that the scale can be read. */
function ticks([least, most], count) {
  const raw = (most - least) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const by = (step) => {
    const all = [];
    for (let n = Math.ceil(least / step); n * step <= most; n += 1) all.push(Number((n * step).toPrecision(12)));
    return all;
  };
  const steps = [0.5, 1, 2, 5, 10].map((n) => n * power);
  const wide = steps.findIndex((size) => size >= raw);
  const found = by(steps[wide]);
  return found.length < 3 && wide > 0 ? by(steps[wide - 1]) : found;
}

/**
 * Draws axes and series into an element.
 * `series`: `{ kind: 'line' | 'dots' | 'band', x, y, low, high, style, label }`; `marks`: vertical lines `{ x, label }`.
 */
function plot(into, { title, x, y, series, marks = [], height = 240, xRange, yRange, square = false }) {
  const width = Math.max(280, into.clientWidth || 560);
  const [left, right, top, bottom] = [58, 12, 12, 40];
  let xs = xRange || rangeOf(series.map((one) => one.x), 0.02);
  let ys = yRange || rangeOf(series.flatMap((one) => (one.kind === 'band' ? [one.low, one.high] : [one.y])));
  if (square) {
    const perPixel = Math.max((xs[1] - xs[0]) / (width - left - right), (ys[1] - ys[0]) / (height - top - bottom));
    const around = ([low, high], pixels) => [0.5 * (low + high - perPixel * pixels), 0.5 * (low + high + perPixel * pixels)];
    [xs, ys] = [around(xs, width - left - right), around(ys, height - top - bottom)];
  }
  const px = (value) => left + ((value - xs[0]) / (xs[1] - xs[0])) * (width - left - right);
  const py = (value) => height - bottom - ((value - ys[0]) / (ys[1] - ys[0])) * (height - top - bottom);
  const drawn = h('svg:svg', { viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': title, class: 'plot' });
  const text = (content, at, more = {}) => h('svg:text', { x: at[0], y: at[1], ...more }, content);
  for (const tick of ticks(xs, Math.max(3, width / 110))) {
    drawn.append(h('svg:line', { x1: px(tick), x2: px(tick), y1: top, y2: height - bottom, class: 'grid' }),
      text(number(tick, 6), [px(tick), height - bottom + 15], { 'text-anchor': 'middle' }));
  }
  for (const tick of ticks(ys, Math.max(4, height / 42))) {
    drawn.append(h('svg:line', { x1: left, x2: width - right, y1: py(tick), y2: py(tick), class: 'grid' }),
      text(number(tick, 6), [left - 6, py(tick) + 4], { 'text-anchor': 'end' }));
  }
  drawn.append(text(x, [0.5 * (left + width - right), height - 6], { 'text-anchor': 'middle', class: 'axis' }));
  const middle = 0.5 * (top + height - bottom);
  drawn.append(text(y, [13, middle], { 'text-anchor': 'middle', class: 'axis', transform: `rotate(-90 13 ${middle})` }));
  for (const mark of marks) {
    drawn.append(h('svg:line', { x1: px(mark.x), x2: px(mark.x), y1: top, y2: height - bottom, class: 'mark' }),
      text(mark.label, [px(mark.x) + 4, top + 12], { class: 'axis' }));
  }
  const points = (a, b) => a.map((value, i) => [value, b[i]]).filter(([u, v]) => Number.isFinite(u) && Number.isFinite(v));
  const path = (list) => list.map(([u, v], i) => `${i ? 'L' : 'M'}${px(u).toFixed(1)} ${py(v).toFixed(1)}`).join('');
  const inside = h('svg:g', {});
  for (const one of series) {
    if (one.kind === 'band') {
      const there = points(one.x, one.low);
      const back = points(one.x, one.high).reverse();
      inside.append(h('svg:path', { d: `${path(there.concat(back))}Z`, class: `band ${one.style}` }));
    } else if (one.kind === 'line') {
      inside.append(h('svg:path', { d: path(points(one.x, one.y)), class: `line ${one.style}` }));
    } else {
      const dot = ([u, v]) => `M${px(u).toFixed(1)} ${py(v).toFixed(1)}h0`;
      inside.append(h('svg:path', { d: points(one.x, one.y).map(dot).join(''), class: `dots ${one.style}` }));
    }
  }
  drawn.append(inside);
  const named = series.filter((one) => one.label);
  const key = named.map((one) => h('span', { class: `key ${one.kind} ${one.style}` }, one.label));
  into.replaceChildren(drawn, ...(key.length > 1 ? [h('p', { class: 'keys' }, ...key)] : []));
}

/** Redraws when the width changes. */
function responsive(into, draw) {
  let width = 0;
  const observer = new ResizeObserver(() => {
    if (!into.isConnected) { observer.disconnect(); return; }
    if (into.clientWidth > 0 && Math.abs(into.clientWidth - width) > 4) { width = into.clientWidth; draw(); }
  });
  observer.observe(into);
}

/**
 * A map: one rectangle per cell with a text. `cells`: `{ column, row, text, name, style, strong, onclick, isChosen }`; `name` is for screen readers.
 */
function cellMap(into, { title, columns, rows, cells, columnName }) {
  const width = Math.max(240, into.clientWidth || 360);
  // Names of columns are wider than narrow columns.
  const [left, right, top, bottom] = [64, 18, 6, 36];
  const cell = (width - left - right) / Math.max(1, columns.length);
  const line = 26;
  const height = top + bottom + line * rows.length;
  const drawn = h('svg:svg', { viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': title, class: 'plot map' });
  for (const { column, row, text, name, style, strong, onclick, isChosen } of cells) {
    const [x, y] = [left + cell * column, top + line * row];
    const more = onclick ? { onclick, cursor: 'pointer' } : {};
    drawn.append(h('svg:g', more, h('svg:title', {}, name),
      h('svg:rect', { x: x + 0.5, y: y + 0.5, width: cell - 1, height: line - 1, rx: 2, class: `cell ${style}` }),
      cell > 26 ? h('svg:text', { x: x + 0.5 * cell, y: y + 17, 'text-anchor': 'middle', class: strong ? 'strong' : '' }, text) : null,
      isChosen ? h('svg:rect', { x: x + 1.5, y: y + 1.5, width: cell - 3, height: line - 3, rx: 2, class: 'chosen' }) : null));
  }
  rows.forEach((name, row) => drawn.append(h('svg:text', { x: left - 6, y: top + line * row + 17, 'text-anchor': 'end' }, name)));
  const longest = Math.max(...columns.map((name) => name.length));
  const every = Math.ceil((7 * longest + 8) / cell);
  columns.forEach((name, column) => {
    if (column % every === 0) drawn.append(h('svg:text', { x: left + cell * (column + 0.5), y: height - bottom + 15, 'text-anchor': 'middle' }, name));
  });
  drawn.append(h('svg:text', { x: left + 0.5 * (width - left - right), y: height - 4, 'text-anchor': 'middle', class: 'axis' }, columnName));
  into.replaceChildren(drawn);
}

/** Step of the colours of a mean residual, in standard deviations; the last is reached at 4. */
const stepOfResidual = (value) => Math.round(8 * Math.min(1, Math.abs(value) / 4));

/** Whether a mean residual has a strong colour. */
const isStrong = (value) => stepOfResidual(value) > 4;

/**
 * A map of residuals: mean in standard deviations per cell. `cells`: `{ column, row, value, count }`.
 * Blue is measured below the model, orange above; the number stands in the cell.
 */
function residualMap(into, { cells, columns, rows, columnName, rowName, ...settings }) {
  const drawn = cells.map(({ column, row, value, count }) => {
    const step = stepOfResidual(value);
    const name = `${rowName} ${rows[row]}, ${columnName} ${columns[column]}: mean residual ${number(value, 2)} standard deviations, ${count} readings`;
    return { column, row, name, text: number(Number(value.toFixed(1)), 2), style: `${value < 0 ? 'below' : 'above'} s${step}`, strong: isStrong(value) };
  });
  cellMap(into, { ...settings, columns, rows, columnName, cells: drawn });
}

/** An SVG text of the engine as an element. */
function figure({ name, title, svg }) {
  const parsed = new DOMParser().parseFromString(svg, 'image/svg+xml').documentElement;
  parsed.setAttribute('viewBox', `0 0 ${parsed.getAttribute('width')} ${parsed.getAttribute('height')}`);
  parsed.removeAttribute('width');
  parsed.removeAttribute('height');
  parsed.setAttribute('role', 'img');
  parsed.setAttribute('aria-label', title);
  const save = h('button', { type: 'button', class: 'small', onclick: () => saveFile(`${name}.svg`, svg, 'image/svg+xml') }, 'Save SVG');
  return h('figure', { class: 'made' }, document.importNode(parsed, true), h('figcaption', {}, title, ' ', save));
}
