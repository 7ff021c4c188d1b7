// Diagnose: regions in which model and measurement disagree, the missing effect, and the misfit with the effects that are switched on.

const VERDICTS = {
  adequate: 'These runs show no missing effect: the plain model explains them within noise and the usual imperfections of rig and tissue.',
  unexplained: 'A misfit remains: either no effect of the catalogue explains it, or these runs cannot show which effect does.',
};

/** The verdict in words that name what was found. */
function verdictOf(found) {
  if (VERDICTS[found.verdict]) return VERDICTS[found.verdict];
  const names = found.effects.map((one) => explanations(one).join(', or '));
  const isClass = found.effects.some((one) => one.class.length > 1);
  return `Missing in the model: ${names.join('; and ')}.${isClass ? ' These runs cannot distinguish between them.' : ''}`;
}
const CHANNELS = { force_y: 'Force', shape_y: 'Shape', tip_y: 'Tip', tip_direction_y: 'Tip direction', force_x: 'Horizontal force', shape_x: 'Horizontal shape', tip_x: 'Horizontal tip', tip_direction_x: 'Horizontal tip direction' };
const COORDINATES = { insertion_depth_mm: 'insertion depth, mm', depth_below_entry_mm: 'depth below the surface, mm', level_mm: 'displacement of guide 2, mm', direction: 'direction of motion', time_in_hold_s: 'time in a hold, s' };

function showDiagnose() {
  within('diagnose', async (isHere) => {
    const catalogue = await effectsOf();
    const { document: found, figures } = await result('diagnose', {}, 'Diagnosing');
    if (!isHere()) return;
    const investigation = investigationSection(await engine.request('quick', { do: 'investigation', dir: state.session }));
    if (!isHere()) return;
    const about = (id) => catalogue.find((one) => one.id === id);
    const ranked = found.ranking.filter((one) => !found.not_identifiable.includes(one.id));
    const foundation = found.foundation.used;
    const chosen = new Set((state.choice.effects || '').split(',').filter((id) => ranked.some((one) => one.id === id)));
    const boxes = Object.fromEntries(['numbers', 'bars', 'maps', 'values'].map((name) => [name, h('div', { class: name, id: `diagnose-${name}` })]));
    const switches = new Map();
    let trial = null;
    const draw = () => { if (trial) doubt(found, trial, drawTrial(trial, boxes)); };
    const ask = latest(async () => {
      try {
        boxes.numbers.setAttribute('aria-busy', 'true');
        const began = performance.now();
        const next = await engine.request('quick', { do: 'try', dir: state.session, foundation, effects: [...chosen] });
        if (!isHere()) return;
        trial = next;
        boxes.numbers.dataset.effects = trial.effects.map((one) => one.id).join(',');
        boxes.numbers.dataset.took = Math.round(performance.now() - began);
        boxes.numbers.removeAttribute('aria-busy');
        hideFault();
        draw();
      } catch (error) {
        if (isHere()) fail(error);
      }
    });
    const choose = (ids) => {
      chosen.clear();
      ids.forEach((id) => chosen.add(id));
      switches.forEach((input, id) => { input.checked = chosen.has(id); });
      keepAddress({ effects: [...chosen].join(',') });
      ask();
    };
    const most = Math.max(found.margin, ...ranked.map((one) => one.log_evidence_gain)) * 1.02;
    const row = (one) => {
      const input = h('input', { type: 'checkbox', role: 'switch', id: `effect-${one.id}`, checked: chosen.has(one.id),
        onchange: () => choose([...chosen].filter((id) => id !== one.id).concat(input.checked ? [one.id] : [])) });
      switches.set(one.id, input);
      const share = Math.max(0, one.log_evidence_gain) / most;
      const bar = h('svg:svg', { class: 'evidence', viewBox: '0 0 100 8', preserveAspectRatio: 'none', 'aria-hidden': 'true' },
        h('svg:rect', { x: 0, y: 1, height: 6, width: 100 * share, class: one.log_evidence_gain > found.margin ? 'enough' : '' }),
        h('svg:line', { x1: (100 * found.margin) / most, x2: (100 * found.margin) / most, y1: 0, y2: 8 }));
      return h('li', {}, h('label', { for: input.id }, input, capital(plainName(one.id))), bar, h('span', { class: 'gain' }, `${one.refitted ? '' : '\u2248 '}${number(one.log_evidence_gain)}`),
        h('p', { class: 'note' }, h('code', {}, one.id), ': ', about(one.id)?.physics));
    };
    const list = (some) => h('ul', { class: 'effects' }, ...some.map(row));
    const named = found.effects.map((one) => one.id);
    main().append(
      h('section', { class: `lead verdict ${found.verdict}`, id: 'verdict', 'data-verdict': found.verdict }, h('h2', {}, verdictOf(found)), h('p', { id: 'verdict-doubt', hidden: true }),
        ...found.effects.map((one) => reasons(one, found, about)), limits(found)),
      ...(investigation ? [investigation] : []),
      h('div', { class: 'two' },
        h('section', { class: 'controls' }, h('h2', {}, 'Effects: switch them on and off'),
          h('p', { class: 'note' }, 'Bars: ', term('log evidence'), ` of one effect added to the `, term('plain model'), `. An effect can be named if its bar passes the line (${number(found.margin)}). Fitted effects come first; \u2248 marks an estimate without a fit. Each switch fits the model again.`),
          h('p', { class: 'bar' }, named.length ? h('button', { type: 'button', id: 'use-found', onclick: () => choose(named) }, 'Switch on the effects that were found') : null,
            h('button', { type: 'button', id: 'use-none', onclick: () => choose([]) }, 'All off')),
          list(ranked.slice(0, 8)), ranked.length > 8 ? h('details', {}, h('summary', {}, `${ranked.length - 8} more effects`), list(ranked.slice(8))) : null,
          found.not_identifiable.length ? h('p', { class: 'note' }, `These runs cannot show: ${found.not_identifiable.map((id) => plainName(id)).join(', ')}`) : null),
        h('section', {}, h('h2', {}, 'Misfit between model and measurement'), boxes.numbers, boxes.bars, boxes.values,
          h('h2', {}, 'Maps of the residuals'), h('p', { class: 'note' }, 'Mean ', term('residual'), ' per cell in ', term('standard deviations'), ' of the noise of one reading. Orange: measured more than the model computes. Blue: less. Force and shape count as positive in the direction in which guide 2 is displaced.'), boxes.maps)),
      h('div', { class: 'beyond' }, section('Regions with significant residuals of the plain model', regions(found)),
        section('Figures of the diagnosis', h('details', {}, h('summary', {}, `${figures.length} figures`), ...figures.map(figure)))),
      saveBar('diagnose', () => found));
    responsive(boxes.maps, draw);
    ask();
  });
}

function reasons(one, found, about) {
  const values = Object.entries(one.parameters).map(([name, value]) => { const [label, unit] = unitOf(name); return `${label} ${number(value.value)} (${interval(value.ci95)}) ${unit}`.trim(); });
  const others = one.class.filter((id) => id !== one.id);
  const gap = found.gap;
  const list = [
    `${values.join(', ')}.`,
    `Log evidence ${signed(one.log_evidence_gain)}, needed ${signed(found.margin)}.`,
    gap ? `On the held-out runs the misfit (chi-square per reading) changes from ${number(gap.before.chi2_reduced)} to ${number(gap.after.chi2_reduced)}.` : 'No run could be held out.',
    others.length ? `Not excluded: ${others.map((id) => plainName(id)).join(', ')}.` : 'No other effect explains the runs as well.',
  ];
  return h('div', {}, h('h3', {}, capital(plainName(one.id, one.parameters))), h('p', { class: 'note' }, h('code', {}, one.id), `: ${about(one.id)?.physics ?? ''}`), h('ul', {}, ...list.map((text) => h('li', {}, text))));
}

function limits(found) {
  const next = found.next_measurement;
  return h('div', {}, next ? h('p', { id: 'next' }, h('strong', {}, 'Measure next: '), `${next.what}; it distinguishes ${next.separates.map((id) => plainName(id)).join(' and ')}.`) : null,
    found.limits.length + found.warnings.length ? h('div', {}, h('h3', {}, 'Limits and notes'), h('ul', {}, ...[...found.warnings, ...found.limits].map((text) => h('li', {}, text)))) : null,
    found.split ? h('p', { class: 'note' }, capital(found.split)) : null);
}

/** Adds a warning to the verdict if a cell of the maps has a strong colour under the model of the verdict. */
function doubt(found, trial, { plain, now }) {
  const named = found.effects.map((one) => one.id);
  const isOn = trial.effects.length === named.length && trial.effects.every((one) => named.includes(one.id));
  if (named.length > 0 && !isOn) return;
  const strongest = named.length > 0 ? now : plain;
  const line = document.getElementById('verdict-doubt');
  line.hidden = !strongest.isStrong;
  const size = `But residuals of up to ${number(Math.abs(strongest.value), 2)} standard deviations remain (${strongest.name}, map below)`;
  line.textContent = named.length > 0 ? `${size}: the effects do not explain everything.`
    : `${size}. The model does not explain them, but usual imperfections of rig and tissue can cause them: a needle\u2019s stiffness, for instance, is known to 2 % only.`;
  document.getElementById('verdict').classList.toggle('doubtful', strongest.isStrong);
}

function regions(found) {
  if (found.where.length === 0) return h('p', {}, 'No region has significant residuals.');
  return h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Regions with significant residuals' }, h('table', {},
    h('thead', {}, h('tr', {}, ...['Sensor', 'Along', 'From', 'To', 'Mean residual', 'Standard deviations'].map((name) => h('th', { scope: 'col' }, name)))),
    h('tbody', {}, ...found.where.map((one) => h('tr', {}, h('th', { scope: 'row' }, CHANNELS[one.channel] ?? one.channel), h('td', {}, COORDINATES[one.coordinate] ?? one.coordinate),
      h('td', {}, number(one.from)), h('td', {}, number(one.to)), h('td', {}, `${number(one.mean_residual)} ${one.unit}`), h('td', {}, number(one.sigma)))))));
}

/** A bar that keeps its element, so that its width moves to the new value. */
function bar(into, key, name, before, after, unit, most) {
  let row = into.querySelector(`[data-key="${key}"]`);
  if (!row) {
    row = h('div', { class: 'shrink', 'data-key': key }, h('span', { class: 'name' }, name), h('span', { class: 'track', 'aria-hidden': 'true' }, h('span', { class: 'was' }), h('span', { class: 'now' })), h('span', { class: 'value' }));
    into.append(row);
  }
  row.querySelector('.was').style.width = `${(100 * before) / most}%`;
  row.querySelector('.now').style.width = `${(100 * after) / most}%`;
  row.querySelector('.value').textContent = `${number(after)} ${unit}${Math.abs(after / before - 1) < 5e-4 ? '' : ` (was ${number(before)})`}`;
}

function drawTrial(trial, { numbers, bars, maps, values }) {
  const judged = trial.held_out ?? { before: trial.learned[0], after: trial.learned[1] };
  const [before, after] = [judged.before, judged.after];
  numbers.dataset.before = before.chi2_reduced;
  numbers.dataset.after = after.chi2_reduced;
  const isSame = trial.effects.length === 0;
  const where = trial.held_out ? `on runs held out of every fit: ${trial.held_out.heldout_runs.join(', ')}` : 'on the fitted runs, as no run could be held out';
  numbers.replaceChildren(modelLine(isSame ? 'plain, no effect is switched on' : `with ${trial.effects.map((one) => plainName(one.id, one.parameters)).join(', and ')}`), h('p', { class: 'readout' }, h('span', { class: 'big' }, `${number(before.chi2_reduced)}${isSame ? '' : ` \u2192 ${number(after.chi2_reduced)}`}`), ' ', term('chi-square per reading'), ` (about 1: noise alone), ${where}`),
    h('p', {}, isSame ? '' : `Log evidence ${signed(trial.log_evidence_gain)}. `, `${trial.foundation === 'body' ? 'Young\u2019s modulus E' : 'Foundation modulus K'} ${number(trial.modulus_kpa.value)} kPa (${interval(trial.modulus_kpa.ci95)}).`));
  const most = (unit) => Math.max(...Object.entries(before.rmse).concat(Object.entries(after.rmse)).filter(([name]) => name.endsWith(`_${unit}`)).map(([, value]) => value));
  if (bars.childElementCount === 0) bars.append(h('h3', {}, 'Root mean square of the residuals'));
  const order = Object.keys(CHANNELS);
  const byChannel = Object.entries(before.rmse).sort(([a], [b]) => order.findIndex((name) => a.startsWith(name)) - order.findIndex((name) => b.startsWith(name)));
  for (const [name, was] of byChannel) {
    const unit = name.split('_').pop();
    const channel = name.slice(0, -unit.length - 1);
    bar(bars, name, CHANNELS[channel] ?? channel, was, after.rmse[name], unit === 'n' ? 'N' : unit, most(unit));
  }
  values.replaceChildren(...trial.effects.map((one) => h('p', {}, h('code', {}, one.id), ' ',
    Object.entries(one.parameters).map(([name, value]) => { const [label, unit] = unitOf(name); return `${label} ${number(value.value)} (${interval(value.ci95)}) ${unit}`.trim(); }).join(', '))));
  return drawMaps(trial.points, maps, isSame);
}

/** Draws the maps, and returns the cells with the largest residuals: of the plain model, and of the model with the effects that are on. */
function drawMaps(points, maps, isSame) {
  const strongest = { plain: { value: 0, isStrong: false, name: '' }, now: { value: 0, isStrong: false, name: '' } };
  const keep = (side, shown, name) => shown.filter(({ value }) => Math.abs(value) > Math.abs(strongest[side].value))
    .forEach(({ value }) => { strongest[side] = { value, isStrong: isStrong(value), name: name.toLowerCase() }; });
  const channels = [...new Set(points.map((point) => point.channel))].filter((channel) => channel.endsWith('_y'));
  let place = 0;
  channels.forEach((channel) => {
    const own = points.filter((point) => point.channel === channel);
    const isTip = channel.startsWith('tip');
    // Displacements in steps of a tenth, or wider ones where there are many.
    const widest = Math.max(...own.map((point) => Math.abs(point.displacement_mm)));
    const level = [0.1, 0.2, 0.5, 1, 2, 5].find((step) => (2 * widest) / step <= 12.5 && new Set(own.map((point) => Math.round(point.displacement_mm / step))).size <= 7) ?? 10;
    const rowOf = isTip ? (point) => point.run : (point) => number(Number((level * Math.round(point.displacement_mm / level)).toFixed(1)) + 0, 3);
    const rows = [...new Set(own.map(rowOf))];
    if (!isTip) rows.sort((a, b) => Number(b.replace('\u2212', '-')) - Number(a.replace('\u2212', '-')));
    if (rows.length > 14) return;
    const depths = own.map((point) => point.depth_mm);
    const distinct = [...new Set(depths.map((depth) => Number(depth.toFixed(1))))].sort((a, b) => a - b);
    const width = distinct.length > 10 ? Math.ceil((Math.max(...depths) + 1e-9) / 10) : 0;
    const columnOf = width ? (depth) => Math.min(9, Math.floor((depth - 1e-9) / width)) : (depth) => distinct.indexOf(Number(depth.toFixed(1)));
    const columns = width ? Array.from({ length: Math.min(10, Math.ceil(Math.max(...depths) / width)) }, (_, i) => `${i * width}\u2013${(i + 1) * width}`) : distinct.map((depth) => String(depth));
    const cells = (side) => {
      const sums = new Map();
      own.forEach((point) => {
        const key = `${Math.max(0, columnOf(point.depth_mm))} ${rows.indexOf(rowOf(point))}`;
        const sum = sums.get(key) ?? { value: 0, count: 0 };
        const towards = !isTip && point.displacement_mm < -1e-9 ? -1 : 1;
        sum.value += (towards * point[side]) / point.noise_sd;
        sum.count += 1;
        sums.set(key, sum);
      });
      return [...sums].map(([key, sum]) => { const [column, row] = key.split(' ').map(Number); return { column, row, value: sum.value / sum.count, count: sum.count }; });
    };
    const name = CHANNELS[channel] ?? channel;
    const settings = { columns, rows, columnName: channel.startsWith('force') ? 'insertion depth, mm' : isTip ? 'insertion depth, mm' : 'depth below the surface, mm', rowName: isTip ? 'insertion' : 'displacement of guide 2, mm' };
    if (!maps.children[place]) {
      maps.append(h('div', { class: 'pair' }, h('div', { class: 'panel' }, h('h3', {}, `${name}, plain model`), h('p', { class: 'note' }, `Rows: ${settings.rowName}`), h('div', {})), h('div', { class: 'panel' }, h('h3', {}, `${name}, now`), h('p', { class: 'note' }, `Rows: ${settings.rowName}`), h('div', {}))));
    }
    const [was, now] = maps.children[place].children;
    place += 1;
    const [plain, shown] = [cells('before'), cells(isSame ? 'before' : 'after')];
    residualMap(was.lastChild, { title: `${name}: residuals of the plain model`, cells: plain, ...settings });
    residualMap(now.lastChild, { title: `${name}: residuals with the effects that are on`, cells: shown, ...settings });
    keep('plain', plain, name);
    keep('now', shown, name);
  });
  return strongest;
}
