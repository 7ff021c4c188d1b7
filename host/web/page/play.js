// Play: a needle in its tissue, drawn to scale, that answers while a slider is dragged.

const SLIDERS = [
  ['k_kpa', 'Foundation modulus K', 'kPa', 1, 100, 0.5, 12],
  ['depth_mm', 'Insertion depth', 'mm', 5, 120, 1, 50],
  ['displacement_mm', 'Displacement of guide 2', 'mm', -3, 3, 0.05, 1.5],
  ['gap_mm', 'Gap from guide 2 to the surface', 'mm', 0, 40, 1, 10],
  ['tip_load_n', 'Load on the tip', 'N', -0.5, 0.5, 0.01, 0.2],
];

const unitOf = (name) => {
  const units = [['_n_per_mm', 'N/mm'], ['_mm_per_n', 'mm/N'], ['_per_mm', '1/mm'], ['_mrad', 'mrad'], ['_deg', '\u00b0'], ['_mm', 'mm'], ['_n', 'N'], ['_s', 's'], ['_kpa', 'kPa'], ['_percent', '%']];
  const found = units.find(([end]) => name.endsWith(end));
  return found ? [name.slice(0, -found[0].length).replaceAll('_', ' ') || name, found[1]] : [name.replaceAll('_', ' '), ''];
};

/** A slider with its value; `onchange` gets the number. */
function slider(id, label, unit, [least, most, step], value, onchange) {
  const shown = h('output', { for: id }, `${number(value, 4)} ${unit}`);
  const range = h('input', { type: 'range', id, min: least, max: most, step, value,
    oninput: () => { shown.textContent = `${number(Number(range.value), 4)} ${unit}`; onchange(Number(range.value)); } });
  return h('div', { class: 'slider' }, h('label', { for: id }, label), shown, range);
}

async function effectsOf() {
  state.effects ??= await engine.request('quick', { do: 'effects' });
  return state.effects;
}

function showPlay() {
  within('play', async (isHere) => {
    announce('Preparing the engine ...');
    const catalogue = await effectsOf();
    if (!isHere()) return;
    announce(null);
    const values = Object.fromEntries(SLIDERS.map(([name, , , , , , start]) => [name, Number(state.choice[name] ?? start)]));
    const chosen = new Map();
    const [needle, cycle, path] = ['drawn wide', 'drawn', 'drawn'].map((name) => h('div', { class: name }));
    const readout = h('p', { class: 'readout', id: 'play-force', 'aria-live': 'off' });
    let last = null;
    const model = h('div', {});
    const draw = () => {
      if (!last) return;
      model.replaceChildren(modelLine(chosen.size ? `with ${[...chosen].map(([id, own]) => plainName(id, own)).join(', and ')}; grey: without` : 'plain, without effects'));
      drawPlay(last, values, { needle, cycle, path, readout });
    };
    const ask = latest(async () => {
      try {
        const effects = Object.fromEntries([...chosen].map(([id, own]) => [id, own]));
        last = await engine.request('quick', { do: 'play', ...values, effects });
        if (isHere()) { draw(); hideFault(); }
      } catch (error) {
        if (isHere()) fail(error);
      }
    });
    const changed = () => {
      keepAddress({ ...values, with: [...chosen].map(([id, own]) => `${id}:${Object.values(own).join(':')}`).join(',') });
      ask();
    };
    const sliders = SLIDERS.map(([name, label, unit, least, most, step]) =>
      slider(`play-${name}`, label, unit, [least, most, step], values[name], (value) => { values[name] = value; changed(); }));
    const added = h('div', { id: 'play-effects' });
    const select = h('select', { id: 'play-add', onchange: () => { if (select.value) { add(select.value); select.value = ''; changed(); } } },
      h('option', { value: '' }, 'Choose an effect'), ...catalogue.map((one) => h('option', { value: one.id }, capital(plainName(one.id)))));
    const add = (id, start = []) => {
      const effect = catalogue.find((one) => one.id === id);
      if (!effect || chosen.has(id)) return;
      const own = {};
      const box = h('fieldset', {}, h('legend', {}, capital(plainName(id))), h('p', { class: 'note' }, h('code', {}, id), ': ', effect.physics));
      effect.parameters.forEach((info, index) => {
        const [least, most] = info.likely;
        // The slider starts where the effect is visible: half way from the neutral value to the end of the likely range.
        const shows = info.is_place ? info.neutral : info.neutral + 0.5 * (most - info.neutral || least - info.neutral);
        own[info.name] = Number.isFinite(start[index]) ? start[index] : shows;
        const [name, unit] = unitOf(info.name);
        box.append(slider(`play-${id}-${info.name}`, name, unit, [least, most, (most - least) / 200], own[info.name], (value) => { own[info.name] = value; changed(); }));
      });
      box.append(h('button', { type: 'button', class: 'small', onclick: () => { chosen.delete(id); box.remove(); changed(); select.focus(); } }, `Remove ${plainName(id)}`));
      chosen.set(id, own);
      added.append(box);
    };
    (state.choice.with || '').split(',').filter(Boolean).forEach((one) => { const [id, ...start] = one.split(':'); add(id, start.map(Number)); });
    main().append(h('div', { class: 'two' },
      h('section', { class: 'controls' }, h('h2', {}, 'Needle and tissue'), ...sliders,
        h('div', { class: 'slider' }, h('label', { for: 'play-add' }, 'Add an effect'), select), added),
      h('section', {}, h('h2', {}, 'Readings of the sensors'), readout, model, needle,
        h('div', { class: 'panels' }, h('div', { class: 'panel' }, h('h3', {}, 'Guide 2 moves out, to the other side and back'), cycle),
          h('div', { class: 'panel' }, h('h3', {}, 'Path of the tip on the way in'), path)))),
      saveBar('play', () => ({ input: { ...values, effects: Object.fromEntries(chosen) }, ...last })));
    responsive(needle, draw);
    ask();
  });
}

/** The rig in side view, lengths and deflections to the same scale. */
function drawPlay(last, values, { needle, cycle, path, readout }) {
  const { with: one, without } = last;
  readout.replaceChildren(h('span', { class: 'big' }, `${number(one.force_n, 4)} N`),
    ` at ${number(values.displacement_mm)} mm`, without ? ` (without effects ${number(without.force_n, 4)} N)` : '');
  const end = last.entry_mm + values.depth_mm;
  const [left, right] = [-8, end + 10];
  const half = 16;
  const drawn = h('svg:svg', { viewBox: `${left} ${-half} ${right - left} ${2 * half}`, role: 'img', class: 'rig',
    'aria-label': `Needle to scale: guide 2 moved by ${number(values.displacement_mm)} mm, force ${number(one.force_n)} newton, ${number(values.depth_mm)} mm in the tissue` });
  const line = (side, style) => h('svg:path', { class: style, 'stroke-width': last.outer_diameter_mm,
    d: side.z_mm.map((z, i) => `${i ? 'L' : 'M'}${z.toFixed(2)} ${(-side.deflection_mm[i]).toFixed(3)}`).join('') });
  const guide = (z, y, name) => [-1, 1].map((side) => h('svg:rect', { x: z - 2, y: -y + side * 3.4 - 2.6, width: 4, height: 5.2, class: 'guide' }))
    .concat(h('svg:text', { x: z, y: -y - 7.4, 'text-anchor': 'middle' }, name));
  drawn.append(h('svg:rect', { x: last.entry_mm, y: -half, width: right - last.entry_mm, height: 2 * half, class: 'tissue' }),
    h('svg:text', { x: last.entry_mm + 2, y: half - 2 }, 'tissue'),
    ...guide(0, 0, 'guide 1'), ...guide(last.guide2_mm, values.displacement_mm, 'guide 2'));
  if (without) drawn.append(line(without, 'needle plain'));
  drawn.append(line(one, 'needle'));
  const force = one.force_n;
  if (Math.abs(force) > 1e-3) {
    const length = Math.min(9, 3 * Math.sqrt(Math.abs(force)));
    const from = -values.displacement_mm + Math.sign(force) * (6.2 + length);
    const to = -values.displacement_mm + Math.sign(force) * 6.2;
    drawn.append(h('svg:path', { class: 'arrow', d: `M${last.guide2_mm} ${from}V${to}m-1.4 ${1.8 * Math.sign(force)}l1.4 ${-1.8 * Math.sign(force)}l1.4 ${1.8 * Math.sign(force)}` }));
  }
  needle.replaceChildren(drawn);
  const both = (x, y) => [...(without ? [{ kind: 'line', x: without[x], y: without[y], style: 'plain', label: 'without effects' }] : []),
    { kind: 'line', x: one[x], y: one[y], style: 'a', label: 'with effects' }];
  plot(cycle, { title: 'Force against displacement of guide 2', x: 'displacement, mm', y: 'force, N', height: 210, series: both('displacement_mm', 'cycle_force_n') });
  plot(path, { title: 'Path of the tip', x: 'insertion depth, mm', y: 'tip, mm', height: 210, series: both('depth_mm', 'tip_mm') });
}
